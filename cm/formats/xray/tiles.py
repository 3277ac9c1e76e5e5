# SPDX-License-Identifier: Apache-2.0
"""The tile grid, where the configuration bits of each tile lie, and which of them each feature of its kind has."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from cm.formats.xray.features import XrayError
from cm.frozen import dataclass

BLOCKS = {"CLB_IO_CLK": "", "BLOCK_RAM": ".block_ram"}  # block of bits → suffix of the segbits file
_INDEX = re.compile(r"\[0*(\d+)\]$")
_BIT = re.compile(r"(!?)(\d+)_(\d+)")


class Bit(NamedTuple):
    """A bit of a tile: frame from the first of its column, bit from the first of its words; and its value."""

    frame: int
    position: int
    value: bool


@dataclass(frozen=True)
class Segbits:
    """The features of one kind of tile in one block type, by name without the kind (``ALUT.INIT[5]``)."""

    features: Mapping[str, tuple[Bit, ...]]

    @cached_property
    def by_set_bit(self) -> Mapping[tuple[int, int], tuple[str, ...]]:
        """The features that want a bit (frame, position) to be 1."""
        found: dict[tuple[int, int], list[str]] = {}
        for name, bits in self.features.items():
            for bit in bits:
                if bit.value:
                    found.setdefault((bit.frame, bit.position), []).append(name)
        return {place: tuple(names) for place, names in found.items()}


def plain_name(name: str) -> str:
    """Return a feature's name with the number in brackets as it is counted: ``INIT[05]`` is ``INIT[5]``."""
    return _INDEX.sub(r"[\1]", name)


def read_segbits(path: Path) -> Segbits:
    """Read a ``segbits_*.db``; a file that is not there has no features. Raises XrayError with file and line."""
    features = {}
    for number, words in _lines(path):
        bits = tuple(_bit(text, f"{path}:{number}") for text in words[1:])
        features[plain_name(words[0].partition(".")[2])] = bits
    return Segbits(features)


def read_ppips(path: Path) -> Mapping[str, str]:
    """Read a ``ppips_*.db``: pips without bits, and whether they are ``always``, ``default`` or a ``hint``."""
    return {words[0].partition(".")[2]: words[1] for _, words in _lines(path) if len(words) == 2}


def _bit(text: str, where: str) -> Bit:
    found = _BIT.fullmatch(text)
    if found is None:
        raise XrayError(f"{where}: {text!r} is not a bit (FRAME_BIT or !FRAME_BIT)")
    return Bit(int(found[2]), int(found[3]), not found[1])


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    return [(number, words) for number, line in enumerate(text.splitlines(), 1) if (words := line.split())]


@dataclass(frozen=True, slots=True)
class Segment:
    """The bits of a tile in one block type.

    `base` is the frame address (FAR) of its first frame, `offset` the first word, `words` how many. A
    tile whose bits are described as those of another kind has `kind`, `start` (words of that kind which
    it does not have) and `sites` (its own site's name → the name there).
    """

    block: str
    kind: str
    base: int
    frames: int
    offset: int
    words: int
    start: int
    sites: Mapping[str, str]

    @property
    def shift(self) -> int:
        """What to add to a bit's position in the segbits for its position in a frame."""
        return 32 * (self.offset - self.start)

    def holds(self, bit: Bit) -> bool:
        """Whether a bit of the kind is one that this tile has."""
        return bit.frame < self.frames and 0 <= bit.position - 32 * self.start < 32 * self.words

    def to_kind(self, name: str) -> str:
        """Return a feature's name as the segbits of `kind` have it."""
        return _renamed(name, self.sites)

    def from_kind(self, name: str) -> str:
        """Return a feature's name of the segbits as this tile has it."""
        return _renamed(name, {there: here for here, there in self.sites.items()})


@dataclass(frozen=True, slots=True)
class Tile:
    """A tile: its kind, its place in the grid (x to the right, y downwards), its sites by name with their kinds."""

    name: str
    kind: str
    x: int
    y: int
    sites: Mapping[str, str]
    segments: tuple[Segment, ...]


def _renamed(name: str, names: Mapping[str, str]) -> str:
    head, dot, rest = name.partition(".")
    return names.get(head, head) + dot + rest


def read_tiles(path: Path) -> dict[str, Tile]:
    """Read a ``tilegrid.json``. Raises XrayError, OSError."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return {name: _tile(name, entry) for name, entry in found.items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise XrayError(f"{path} is not a tile grid of Project X-Ray: {error!r}") from error


def _tile(name: str, entry: dict[str, Any]) -> Tile:
    segments = tuple(_segment(block, bits, entry["type"]) for block, bits in entry["bits"].items() if block in BLOCKS)
    return Tile(name, entry["type"], entry["grid_x"], entry["grid_y"], entry["sites"], segments)


def _segment(block: str, bits: dict[str, Any], kind: str) -> Segment:
    alias = bits.get("alias") or {"type": kind, "start_offset": 0, "sites": {}}
    return Segment(
        block,
        alias["type"],
        int(bits["baseaddr"], 16),
        bits["frames"],
        bits["offset"],
        bits["words"],
        alias["start_offset"],
        alias["sites"],
    )
