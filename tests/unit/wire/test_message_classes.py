# SPDX-License-Identifier: Apache-2.0
"""The classes that setup.py makes of cm.proto: as it says now, and none of what is not understood."""

from __future__ import annotations

from pathlib import Path

import pytest
from scripts import script

from cm.wire.messages import _proto

ROOT = Path(__file__).resolve().parents[3]
PROTO = (ROOT / "cm/wire/cm.proto").read_text(encoding="utf-8")
SOURCE = script("release/message_classes.py").source


def test_the_classes_in_the_tree_are_those_of_cm_proto() -> None:
    assert Path(_proto.__file__).read_text(encoding="utf-8") == SOURCE(PROTO), "run: make setup"


def test_a_field_has_the_default_of_protobuf_and_its_comment() -> None:
    thing = "// A thing.\nmessage Thing {\n  oneof has_a { uint64 a = 1; }  // V\n  repeated Irq b = 2;\n}\n"
    made = SOURCE(PROTO + thing)
    assert '"""A thing."""\n\n    a: int | None = None  # V\n    b: tuple[Irq, ...] = ()\n' in made


@pytest.mark.parametrize("message", ["message A {\n}\n", "// A.\nmessage A {\n  uint64 a = 1 [packed = true];\n}\n"])
def test_what_says_nothing_of_itself_or_is_written_otherwise_is_refused(message: str) -> None:
    with pytest.raises(ValueError, match="message A "):
        SOURCE(f"{PROTO}\n{message}")
