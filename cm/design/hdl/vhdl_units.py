# SPDX-License-Identifier: Apache-2.0
"""VHDL libraries: finds units that are used but declared in no file of their library."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.design.hdl.model import Problem
from cm.design.hdl.vhdl import VHDL_SUFFIXES
from cm.design.hdl.vhdl_text import blank_comments, design_units

WORK = "work"
# libraries that come with the vendor's tool (UG901, "VHDL Support") or with the language
_PROVIDED = frozenset(
    ("ieee", "std", "unisim", "unimacro", "xpm", "secureip", "vital2000", "ieee_proposed", "synopsys")
)
_USED = re.compile(r"\buse\s+(?!entity\b)(\w+)\.(\w+)|\b(?:entity|context)\s+(\w+)\.(\w+)", re.IGNORECASE)


def missing_units(libraries: Mapping[str, tuple[Path, ...]], sources: tuple[Path, ...]) -> Iterator[Problem]:
    """Yield a problem for each unit that is used by its library's name but is in no file of that library.

    `libraries`: files by library; `sources` are in the default one. Names are compared regardless of case.
    """
    texts = {path: (WORK, _text(path)) for path in sources if path.suffix.lower() in VHDL_SUFFIXES}
    for library, paths in libraries.items():
        texts |= {path: (library.lower(), _text(path)) for path in paths}
    declared: dict[str, set[str]] = {}
    for library, text in texts.values():
        units = (unit.name.lower() for unit in design_units(text) if unit.kind != "architecture")
        declared.setdefault(library, set()).update(units)
    told: set[tuple[str, str]] = set()
    for path, (own, text) in texts.items():
        for found in _USED.finditer(text):
            library, unit = (word.lower() for word in (found[1] or found[3], found[2] or found[4]))
            library = own if library == WORK else library
            if library in _PROVIDED or (library, unit) in told or unit in declared.get(library, ()):
                continue
            if found[1] and library not in declared and not _is_library(text, library):
                continue  # a package made visible earlier: `use pkg.name`
            told.add((library, unit))
            line = text.count("\n", 0, found.start()) + 1
            yield Problem(_sentence(library, unit, declared), str(path), line, breaks=True)


def _text(path: Path) -> str:
    return blank_comments(path.read_text(encoding="utf-8", errors="replace"))


def _is_library(text: str, library: str) -> bool:
    return re.search(rf"\blibrary\b[^;]*\b{library}\b[^;]*;", text, re.IGNORECASE) is not None


def _sentence(library: str, unit: str, declared: Mapping[str, set[str]]) -> str:
    elsewhere = next((name for name, units in declared.items() if unit in units), None)
    hint = f"it is in {elsewhere}: move its file" if elsewhere else "add its file"
    where = "sources:" if library == WORK else f"libraries: {{{library}: …}}"
    return f"no file of library {library} has {unit}; {hint} to {where}"
