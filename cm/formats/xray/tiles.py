# SPDX-License-Identifier: Apache-2.0
"""The tile grid: where each tile stands, its sites, and where its configuration bits lie."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cm.formats.xray.features import XrayError
from cm.formats.xray.segbits import Bit
from cm.frozen import dataclass

BLOCKS = {"CLB_IO_CLK": "", "BLOCK_RAM": ".block_ram"}  # block of bits → suffix of the segbits file


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
