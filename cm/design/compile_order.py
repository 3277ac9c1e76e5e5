# SPDX-License-Identifier: Apache-2.0
"""The order in which tools have to be given files: packages and VHDL's other units before what refers to them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

VERILOG = (".v", ".sv", ".svh", ".vh")
VHDL = (".vhd", ".vhdl")
_COMMENT = re.compile(r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*\"""", re.DOTALL)
_PACKAGE = re.compile(r"\bpackage\s+(?:automatic\s+|static\s+)?(\w+)\s*;")
_USE = re.compile(r"\b(\w+)\s*::")
_VHDL_COMMENT = re.compile(r'--[^\n]*|"[^"\n]*"')
_VHDL_UNIT = re.compile(r"\b(?:package|entity|context)\s+(\w+)\s+is\b")
_VHDL_USE = re.compile(r"\b(?:(?:use|entity|context)\s+\w+\s*\.|package\s+body\s|architecture\s+\w+\s+of\s)\s*(\w+)")


def compile_order(files: Iterable[Path]) -> tuple[Path, ...]:
    """Return the files in their order, but each behind those that it refers to.

    Headers and files that cannot be read stay where they are; so do files that refer to each other.
    """
    listed = list(files)
    home: dict[str, Path] = {}
    uses: dict[Path, list[str]] = {}
    for path in listed:
        units, uses[path] = _names(path)
        home |= dict.fromkeys(units, path)
    needs = {path: [home[name] for name in names if name in home] for path, names in uses.items()}
    done: dict[Path, None] = {}

    def place(path: Path, above: frozenset[Path]) -> None:
        for other in needs.get(path, ()):
            if other not in done and other not in above and other != path:
                place(other, above | {path})
        done.setdefault(path)

    for path in listed:
        place(path, frozenset())
    return tuple(done)


def _names(path: Path) -> tuple[list[str], list[str]]:
    """What others may need of a file, and what it needs itself; a VHDL name has its language before it."""
    suffix = path.suffix.lower()
    if suffix in VHDL:
        text = _VHDL_COMMENT.sub(" ", _text(path)).lower()
        units, used = _VHDL_UNIT.findall(text), _VHDL_USE.findall(text)
        return [f"vhdl {name}" for name in units], [f"vhdl {name}" for name in used]
    text = _COMMENT.sub(" ", _text(path)) if suffix in VERILOG else ""
    return _PACKAGE.findall(text), _USE.findall(text)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
