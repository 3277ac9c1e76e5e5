# SPDX-License-Identifier: Apache-2.0
"""Frame addresses, and how many frames every column of a device has, as far as that is public.

`data/columns.json` says from where. A device that is not in it has no geometry: then only the
beginnings of runs are compared with a region.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from cm.formats.bitstream.idcodes import Family
from cm.frozen import dataclass


class FrameAddress(NamedTuple):
    """Where a frame lies. On 7-series bit 5 of ``row`` is the half: bottom rows are 32 and up."""

    block_type: int
    row: int
    column: int
    minor: int = 0


def decode_far(word: int, family: Family) -> FrameAddress:
    """Return the frame address in a FAR word."""
    return FrameAddress(*[word >> shift & ((1 << width) - 1) for shift, width in family.far])


def encode_far(address: FrameAddress, family: Family) -> int:
    """Return the FAR word of a frame address; ValueError if a field does not fit."""
    word = 0
    for value, (shift, width) in zip(address, family.far, strict=True):
        if not 0 <= value < 1 << width:
            raise ValueError(
                f"{address} does not fit a frame address of {family.label}: {value} needs over {width} bits"
            )
        word |= value << shift
    return word


_COLUMNS = Path(__file__).with_name("data") / "columns.json"  # importlib.resources is 2 MiB of a manager


@dataclass(frozen=True, slots=True)
class Row:
    """The columns of one row of one block type: `starts[c]` is the first frame of column `c`, counted from 0.

    The last entry is the number of frames of the whole row.
    """

    starts: tuple[int, ...]

    @property
    def columns(self) -> int:
        """How many columns there are."""
        return len(self.starts) - 1

    def frames(self, column: int) -> int:
        """Return the frames of a column; 0 where there is none."""
        return self.starts[column + 1] - self.starts[column] if column < self.columns else 0


@dataclass(frozen=True, slots=True)
class Geometry:
    """A die: its rows by block type and FAR's row field."""

    rows: Mapping[tuple[int, int], Row]

    def row(self, block_type: int, row: int) -> Row | None:
        """Return a row; None where the device has none, or nothing is known of it."""
        return self.rows.get((block_type, row))

    def frames(self, at: FrameAddress) -> int:
        """Return the frames of the column of an address; 0 where there is none."""
        row = self.row(at.block_type, at.row)
        return row.frames(at.column) if row is not None else 0


def _counts(text: str) -> list[int]:
    """Return frame counts from their short form: ``42 36x2`` is 42, 36, 36."""
    pairs = (item.partition("x") for item in text.split())
    return [int(count) for count, _, times in pairs for _ in range(int(times or 1))]


@cache  # of that die alone: a board has one, and a manager keeps what it has asked for
def geometry_of(device: str | None) -> Geometry | None:
    """Return the geometry of a device by its name (`xc7z020`); None if it is not known."""
    dies = json.loads(_COLUMNS.read_bytes())["dies"]
    columns = next((die["columns"] for die in dies if device in die["devices"]), None)
    if columns is None:
        return None
    rows = {}
    for block_type, kinds in columns.items():
        for kind in kinds:
            row = Row(tuple(accumulate(_counts(kind["frames"]), initial=0)))
            rows.update({(int(block_type), number): row for number in kind["rows"]})
    return Geometry(rows)


IN_ROWS = (0, 1)  # block types of frames that belong to a place: logic and routing, contents of block RAM
_PADS = 2  # of 7-series: frames after each row that belong to no column


class FrameOrder:
    """The frames of a device in the order in which it counts them: a run goes on from an address through these."""

    def __init__(self, geometry: Geometry, family: Family) -> None:
        self.family = family
        self.order: list[int | None] = list(_addresses(geometry, family))  # FAR; None: of no column
        self.place = {far: number for number, far in enumerate(self.order) if far is not None}

    def run(self, far: int) -> Iterator[tuple[int, int]]:
        """Where the frames of a run that begins at `far` go: number in the run, FAR. KeyError for no such address.

        On UltraScale+ it ends with the row: how many frames follow there that belong to no column is not public.
        """
        begin = self.place[far]
        for number in range(begin, len(self.order)):
            address = self.order[number]
            if address is not None:
                yield number - begin, address
            elif self.family is not Family.SERIES7:
                return


def _addresses(geometry: Geometry, family: Family) -> Iterator[int | None]:
    for block_type, row in sorted(key for key in geometry.rows if key[0] in IN_ROWS):
        found = geometry.rows[block_type, row]
        for column in range(found.columns):
            for minor in range(found.frames(column)):
                yield encode_far(FrameAddress(block_type, row, column, minor), family)
        yield from [None] * _PADS


@cache
def frame_order(device: str, family: Family) -> FrameOrder | None:
    """The order of a device's frames by its name (`xc7z020`); None where its columns are not public."""
    geometry = geometry_of(device)
    return None if geometry is None else FrameOrder(geometry, family)
