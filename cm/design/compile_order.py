# SPDX-License-Identifier: Apache-2.0
"""The order in which tools have to be given SystemVerilog files: a package before those that use it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

SUFFIXES = (".v", ".sv", ".svh", ".vh")
_COMMENT = re.compile(r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*\"""", re.DOTALL)
_PACKAGE = re.compile(r"\bpackage\s+(?:automatic\s+|static\s+)?(\w+)\s*;")
_USE = re.compile(r"\b(\w+)\s*::")


def compile_order(files: Iterable[Path]) -> tuple[Path, ...]:
    """Return the files in their order, but those of packages before the first that uses them.

    Headers and files that cannot be read stay where they are; so do packages that use each other.
    """
    listed = list(files)
    texts = {path: _COMMENT.sub(" ", _text(path)) for path in listed if path.suffix.lower() in SUFFIXES}
    home = {name: path for path, text in texts.items() for name in _PACKAGE.findall(text)}
    needs = {path: [home[name] for name in _USE.findall(text) if name in home] for path, text in texts.items()}
    done: dict[Path, None] = {}

    def place(path: Path, above: frozenset[Path]) -> None:
        for other in needs.get(path, ()):
            if other not in done and other not in above and other != path:
                place(other, above | {path})
        done.setdefault(path)

    for path in listed:
        place(path, frozenset())
    return tuple(done)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
