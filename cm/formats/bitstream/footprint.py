# SPDX-License-Identifier: Apache-2.0
"""Footprints: which frames a bitstream writes, and whether they are those of a region.

A frame address says where a run of frames begins. It continues into the columns that follow. If it is public how
many frames these have (`cm.formats.bitstream.geometry`), the end is checked to the frame; otherwise only the widest
column of the family is known, so the beginning is checked exactly, and the length against what the region can hold at
most.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cm.formats.bitstream.idcodes import Family
from cm.formats.bitstream.inspection_report import Footprint, Report
from cm.schema.model import FrameRange


def _widest(family: Family, block_type: int) -> int | None:
    """Return the frames of a family's widest column; None for unknown block types."""
    return family.widest[block_type] if block_type < len(family.widest) else None


def _last_column(item: Footprint, family: Family) -> int:
    """Return the last column that a run reaches, or if that is not known, the one that it reaches at least."""
    if item.last is not None:
        return item.last
    widest = _widest(family, item.block_type)
    return item.column + (max(0, item.frames - 2) // widest if widest else 0)


def footprint_of(report: Report) -> tuple[FrameRange, ...]:
    """Return the frames that a module's bitstream shows its region to own, one range for each row.

    Modules of one region differ in the columns they touch (a real K26 slot: 153 and 157), but they
    stay between the same outermost ones, which is what is learned.
    """
    if report.family is None:
        return ()
    rows: dict[tuple[int, int], tuple[int, int]] = {}
    for item in report.footprint:
        key = (item.block_type, item.row)
        first, last = rows.get(key, (item.column, item.column))
        rows[key] = min(first, item.column), max(last, _last_column(item, report.family))
    return tuple(FrameRange(block, row, first, last) for (block, row), (first, last) in sorted(rows.items()))


def _owned(item: Footprint, allowed: Iterable[FrameRange]) -> bool:
    """Whether every column from the first to the last that is known to be reached is the region's."""
    rows = [area for area in allowed if (area.block_type, area.row) == (item.block_type, item.row)]
    columns = range(item.column, (item.column if item.last is None else item.last) + 1)
    return all(any(area.column_first <= column <= area.column_last for area in rows) for column in columns)


def _holds(item: Footprint, family: Family, allowed: Iterable[FrameRange]) -> bool:
    """Whether a run that begins in the region can also end there; exact where the last column is known."""
    if item.last is not None:
        return True
    widest = _widest(family, item.block_type)
    if widest is None:
        return True
    columns = sum(x.column_last - x.column_first + 1 for x in allowed if x.block_type == item.block_type)
    return item.frames - 1 <= columns * (widest + 2)  # up to two padding frames where a row ends


def outside(report: Report, allowed: Sequence[FrameRange]) -> tuple[Footprint, ...]:
    """Return what a bitstream writes that `allowed` does not contain; empty if all is well.

    Nothing is outside if `allowed` is empty: then nothing is known about the region.
    """
    family = report.family
    if not allowed or family is None:
        return ()
    return tuple(item for item in report.footprint if not (_owned(item, allowed) and _holds(item, family, allowed)))


def describe(ranges: Iterable[FrameRange]) -> str:
    """Return ranges in words, for messages."""
    return ", ".join(
        f"block type {item.block_type} row {item.row} columns {item.column_first}-{item.column_last}" for item in ranges
    )
