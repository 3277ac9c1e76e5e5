# SPDX-License-Identifier: Apache-2.0
"""VHDL as text: blanks comments, splits design units, finds attributes, instances, and units that no file has.

Architectures are most of a file and contain only two things of interest, so they are searched, not parsed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.design.hdl.model import Problem
from cm.frozen import dataclass

VHDL_SUFFIXES = (".vhd", ".vhdl")
_COMMENT = re.compile(r"\"(?:[^\"\n]|\"\")*\"|'.'|--[^\n]*|/\*.*?\*/", re.DOTALL)
_UNIT = re.compile(
    r"(?:^|;)[ \t]*(?P<kind>entity|architecture|package|configuration|context)\s+(?P<body>body\s+)?"
    r"(?P<name>\w+|\\[^\\\n]+\\)\s+"
    r"(?:of\s+(?:\w+\.)*(?P<of>\w+|\\[^\\\n]+\\)\s+)?is\b",
    re.IGNORECASE | re.MULTILINE,
)
_ATTRIBUTE = re.compile(
    r"\battribute\s+(?P<attribute>\w+)\s+of\s+(?P<names>[\w\\\s,]+?)\s*:\s*signal\s+is\s+"
    r"(?P<value>\"(?:[^\"]|\"\")*\"(?:\s*&\s*\"(?:[^\"]|\"\")*\")*)\s*;",
    re.IGNORECASE,
)
_STRING = re.compile(r'"((?:[^"]|"")*)"')
_INSTANCE = re.compile(
    r":\s*(?:(?:entity\s+(?:\w+\.)?|component\s+)(?P<unit>\w+)|(?P<plain>\w+)\s+(?:generic|port)\s+map)\b",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Unit:
    """One design unit: `start` is its offset in the text; `of` the entity of an architecture."""

    kind: str
    name: str
    of: str
    start: int
    text: str


def blank_comments(text: str) -> str:
    """Replace every comment by as many blanks, so that offsets and lines stay."""

    def blank(match: re.Match[str]) -> str:
        found = match.group()
        return re.sub(r"[^\n]", " ", found) if found.startswith(("--", "/*")) else found

    if "/*" in text:
        return _COMMENT.sub(blank, text)
    lines = text.split("\n")  # much faster on large files: few lines have a comment, and a string ends on its line
    return "\n".join(_COMMENT.sub(blank, line) if "--" in line else line for line in lines)


def design_units(text: str) -> Iterator[Unit]:
    """Entities, architectures, packages (their bodies have the kind "package body") in order."""
    found = list(_UNIT.finditer(text))
    starts = [match.start("kind") for match in found]
    for match, start, end in zip(found, starts, [*starts[1:], len(text)], strict=False):
        kind = match["kind"].lower() + (" body" if match["body"] else "")
        yield Unit(kind, match["name"], match["of"] or "", start, text[start:end])


def signal_attributes(text: str) -> Iterator[tuple[str, str, str]]:
    """(signal, attribute, value), the first two in lower case, of `attribute A of S : signal is "…";`."""
    if "x_interface" not in text.lower():  # the only ones of interest; most files have none
        return
    for match in _ATTRIBUTE.finditer(text):
        value = "".join(part.replace('""', '"') for part in _STRING.findall(match["value"]))
        for name in match["names"].split(","):
            yield name.strip().lower(), match["attribute"].lower(), value


def instances(text: str) -> Iterator[str]:
    """Names of the units instantiated in an architecture."""
    for match in _INSTANCE.finditer(text):
        yield match["unit"] or match["plain"]


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
