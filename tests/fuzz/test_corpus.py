# SPDX-License-Identifier: Apache-2.0
"""What the fuzzers start from and have found is read as documented, by every target (`make fuzz` looks further)."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
TARGETS = sorted(path.stem for path in (HERE / "targets").glob("[a-z]*.py"))


@pytest.mark.parametrize("name", TARGETS)
def test_what_is_known_is_read_or_refused(name: str) -> None:
    target = importlib.import_module(f"targets.{name}")
    inputs = [*target.seeds(), *(path.read_bytes() for path in sorted((HERE / "corpus" / name).glob("*")))]
    for data in [b"", *inputs]:
        target.one(data)


def test_every_corpus_has_its_target() -> None:
    assert {path.name for path in (HERE / "corpus").iterdir()} <= set(TARGETS)
