# SPDX-License-Identifier: Apache-2.0
"""What of a 7-series device lies in a set of frames: columns, their kinds, and how much of them is configured.

A frame is 101 words: two for each of 50 rows of tiles, from the bottom up, and word 50 in their middle for the clock
row (UG470, "Configuration Memory Frames"). Of a column, the first 26 frames configure switches between wires, and what
follows the tiles beside them (masks of Project X-Ray's database).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from cm.formats.xray.database import Database
from cm.formats.xray.frames import ECC_MASK, ECC_WORD, Frames
from cm.frozen import dataclass, replace

ROWS = 50  # of tiles in a row of clock regions
SWITCHES = 26  # frames of a column that configure switches
CONTENTS = 1  # block type of what is in block RAM
_PAIR = (1 << 64) - 1
_BY_FRAMES = {36: "CLB", 28: "block RAM or DSP", 30: "clocks or none", 42: "I/O", 32: "transceivers", 128: "contents"}
_BY_TILES = {
    "CLBLM": "CLB with memory",
    "CLBLL": "CLB",
    "BRAM": "block RAM",
    "DSP": "DSP",
    "CLK": "clock spine",
    "CMT": "clock manager",
    "RIOI": "I/O",
    "LIOI": "I/O",
    "CFG": "configuration",
    "MONITOR": "XADC",
    "GT": "transceivers",
    "PCIE": "PCI Express",
}


@dataclass(frozen=True, slots=True)
class FabricColumn:
    """A column: the address of its first frame, its kind, and set bits (checksums left out).

    `bits`: of each frame. `switches`, `logic`: of each row of tiles, from the bottom up, by what they configure.
    `clock`: of the clock row. `names`: of the tiles of each row, where the database knows them.
    """

    address: int
    kind: str
    bits: tuple[int, ...]
    switches: tuple[int, ...]
    logic: tuple[int, ...]
    clock: int
    names: tuple[str, ...] = ()

    @property
    def block_type(self) -> int:
        """0: logic and wires, 1: contents of block RAM."""
        return self.address >> 23 & 7

    @property
    def row(self) -> int:
        """FAR's row field, with the bottom half as bit 5."""
        return self.address >> 17 & 63

    @property
    def number(self) -> int:
        """The column in its row."""
        return self.address >> 7 & 0x3FF


def fabric(frames: Frames) -> tuple[FabricColumn, ...]:
    """Return the columns that frames lie in, by address; their kinds as far as the number of frames tells them."""
    columns = groupby(sorted(frames), lambda address: address >> 7)
    return tuple(_column(first << 7, list(addresses), frames) for first, addresses in columns)


def kind_by_frames(address: int, frames: int) -> str:
    """What a column may be that has so many frames."""
    return "contents" if address >> 23 & 7 == CONTENTS else _BY_FRAMES.get(frames, f"{frames} frames")


def named(columns: Sequence[FabricColumn], database: Database) -> tuple[FabricColumn, ...]:
    """Return columns with the kinds and the names of tiles that the database knows."""
    tiles = _tiles(database, {column.address for column in columns})
    return tuple(_named(column, tiles.get(column.address, {})) for column in columns)


def row_of(word: int) -> int | None:
    """The row of tiles that a word of a frame belongs to; None for the clock row."""
    return None if word == ECC_WORD else (word - (word > ECC_WORD)) // 2


def _named(column: FabricColumn, tiles: Mapping[int, list[str]]) -> FabricColumn:
    if not tiles:
        return column
    kinds = {name.partition("_X")[0] for names in tiles.values() for name in names}
    found = (kind for start, kind in _BY_TILES.items() if any(one.startswith(start) for one in kinds))
    kind = column.kind if column.block_type == CONTENTS else next(found, "wires only")
    return replace(column, kind=kind, names=tuple(", ".join(tiles.get(row, ())) for row in range(ROWS)))


def _column(first: int, addresses: list[int], frames: Frames) -> FabricColumn:
    kept = [(address - first, frames[address] & ~ECC_MASK) for address in addresses]
    contents = first >> 23 & 7 == CONTENTS
    switches, logic, clock = [0] * ROWS, [0] * ROWS, 0
    for minor, frame in kept:
        into = switches if minor < SWITCHES and not contents else logic
        for row, at in enumerate(_offsets()):
            into[row] += (frame >> at & _PAIR).bit_count()
        clock += (frame >> 32 * ECC_WORD & 0xFFFFFFFF).bit_count()
    bits = tuple(frame.bit_count() for _, frame in kept)
    return FabricColumn(first, kind_by_frames(first, len(bits)), bits, tuple(switches), tuple(logic), clock)


def _offsets() -> Iterator[int]:
    """The first bit of the two words of each row of tiles."""
    for row in range(ROWS):
        yield 64 * row + (32 if row >= ROWS // 2 else 0)


def _tiles(database: Database, columns: set[int]) -> Mapping[int, Mapping[int, list[str]]]:
    """The names of the tiles of each row, by column."""
    found: dict[int, dict[int, list[str]]] = {}
    for tile in database.tiles.values():
        for segment in tile.segments:
            if segment.base in columns:
                rows = {row_of(word) for word in range(segment.offset, segment.offset + segment.words)}
                for row in rows - {None}:
                    assert row is not None
                    found.setdefault(segment.base, {}).setdefault(row, []).append(tile.name)
    return found
