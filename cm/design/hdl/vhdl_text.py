# SPDX-License-Identifier: Apache-2.0
"""VHDL as text: blanks comments, splits design units, and finds attributes and instances in architectures.

Architectures are most of a file and contain only two things of interest, so they are searched, not parsed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

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
