# SPDX-License-Identifier: Apache-2.0
"""What protoc makes of cm.proto for languages that no client of ours is written in, with the names that it promises."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs
REPOSITORY = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("language", "file", "names"),
    [
        ("csharp", "Cm.cs", ("namespace Cm.Pb {", "public sealed partial class Status ")),
        ("java", "cm/pb/Status.java", ("package cm.pb;", "public final class Status extends")),
    ],
)
def test_messages_in_other_languages(tmp_path: Path, language: str, file: str, names: tuple[str, ...]) -> None:
    command = ["protoc", "-I.", f"--{language}_out={tmp_path}", "cm/wire/cm.proto"]
    subprocess.run(command, cwd=REPOSITORY, check=True)
    made = (tmp_path / file).read_text()
    assert [name for name in names if name not in made] == []
