# SPDX-License-Identifier: Apache-2.0
"""Features, and their text form (FASM): the settings of a tile, each of which is on or off.

What can be wrong with a database of Project X-Ray, or with features that are to become frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import ClassVar, NamedTuple

from cm.errors import CmError


class XrayError(CmError):
    """The database, a line of FASM or a set of features is not what it should be; the sentence says where."""

    code: ClassVar[str] = "xray"


class DatabaseMissing(XrayError):
    """There is no database of Project X-Ray here, or it does not have the part."""

    code: ClassVar[str] = "xray_database_missing"


_LINE = re.compile(
    r"(?P<tile>[A-Za-z0-9_]+)\.(?P<name>[A-Za-z0-9_.]+)"
    r"(?:\[(?P<high>\d+)(?::(?P<low>\d+))?\])?"
    r"(?:\s*=\s*(?:(?P<width>\d+)?'(?P<base>[bhdo]))?(?P<value>[0-9a-fA-F_]+))?"
)
_BASES = {"b": 2, "o": 8, "d": 10, "h": 16, None: 10}


class Feature(NamedTuple):
    """One feature of one tile, such as ``INT_L_X16Y87`` and ``NW6BEG1.LOGIC_OUTS_L5``.

    A bit of a value has its number, without leading zeros, in brackets: ``SLICEL_X0.ALUT.INIT[5]``.
    """

    tile: str
    name: str

    def __str__(self) -> str:
        return f"{self.tile}.{self.name}"


class Setting(NamedTuple):
    """One line of FASM: the bits `low` to `high` of a feature get `value`; both None for a feature without bits."""

    tile: str
    name: str
    high: int | None
    low: int | None
    value: int

    @property
    def width(self) -> int:
        """How many bits it sets."""
        return 1 if self.high is None or self.low is None else self.high - self.low + 1

    def features(self) -> Iterator[Feature]:
        """The features that are on: one for each bit of the value that is 1."""
        if self.low is None:
            if self.value:
                yield Feature(self.tile, self.name)
            return
        for bit in range(self.width):
            if self.value >> bit & 1:
                yield Feature(self.tile, f"{self.name}[{self.low + bit}]")


def parse(lines: Iterable[str], source: str = "FASM") -> Iterator[Setting]:
    """Read lines of FASM; comments, annotations in braces and empty lines are left out.

    Raises XrayError with `source` and the number of a line that is not FASM.
    """
    for number, line in enumerate(lines, 1):
        text = re.sub(r"\{[^}]*\}", "", line.partition("#")[0]).strip()
        if not text:
            continue
        found = _LINE.fullmatch(text)
        if found is None:
            raise XrayError(f"{source}, line {number}: {text[:80]!r} is not a line of FASM (TILE.FEATURE[7:0] = 8'h2A)")
        yield _setting(found, f"{source}, line {number}")


def _setting(found: re.Match[str], where: str) -> Setting:
    high = None if found["high"] is None else int(found["high"])
    low = high if found["low"] is None else int(found["low"])
    try:
        value = 1 if found["value"] is None else int(found["value"].replace("_", ""), _BASES[found["base"]])
    except ValueError as error:
        raise XrayError(f"{where}: {found['value']!r} is not a number of base {_BASES[found['base']]}") from error
    setting = Setting(found["tile"], found["name"], high, low, value)
    if setting.width < 1 or value >> setting.width:
        raise XrayError(f"{where}: {value} does not fit {setting.width} bits")
    return setting


def read_features(lines: Iterable[str], source: str = "FASM") -> frozenset[Feature]:
    """Return all features that lines of FASM switch on; bits that are 0 say nothing."""
    return frozenset(feature for setting in parse(lines, source) for feature in setting.features())


def fasm(features: Iterable[Feature]) -> str:
    """Return features as FASM, one a line, sorted: equal sets give equal text."""
    return "".join(f"{feature}\n" for feature in sorted(features))
