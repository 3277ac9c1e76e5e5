# SPDX-License-Identifier: Apache-2.0
"""Files of this tree that pages and comments name are there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("cm", "csrc", "docs", "dts", "kmod", "release", "system", "tests")
READ = {".py", ".md", ".c", ".h", ".cpp", ".j2"}
NAMED = re.compile(rf"(?<![\w./<*-])((?:{'|'.join(ROOMS)})/[\w./-]*\w\.(?:py|md|c|h|cpp|proto|json|sh|j2))(?![\w*<{{])")


def pages() -> Iterator[Path]:
    yield from ROOT.glob("*.md")
    for room in ("cm", "csrc", "docs", "kmod"):
        yield from (path for path in (ROOT / room).rglob("*") if path.suffix in READ and path.is_file())


def missing(text: str, folder: Path) -> set[str]:
    return {name for name in NAMED.findall(text) if not ((ROOT / name).exists() or (folder / name).exists())}


@pytest.mark.parametrize(("text", "found"), [("see cm/errors.py", set()), ("# see cm/gone.py.", {"cm/gone.py"})])
def test_a_name_of_no_file_is_noticed(text: str, found: set[str]) -> None:
    assert missing(text, ROOT) == found


def test_files_that_pages_and_comments_name_are_there() -> None:
    read = {path.relative_to(ROOT): missing(path.read_text("utf-8"), path.parent) for path in pages()}
    assert len(read) > 500
    assert {str(path): names for path, names in read.items() if names and path.name != "CHANGELOG.md"} == {}
