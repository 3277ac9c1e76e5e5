# SPDX-License-Identifier: Apache-2.0
"""How far frames reach: the column that the last frame of each run falls into.

A run goes on into the columns behind its address. The last frame that is written only pushes the
one before it out of the frame buffer, and where a row ends two more do (UG470; on UltraScale+ up to
four were seen in Vivado's files), so these are not frames of the next column.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.device.native import bitstream as native
from cm.formats.bitstream.devices import Family
from cm.formats.bitstream.errors import BadPacket
from cm.formats.bitstream.far import FrameAddress, decode_far
from cm.formats.bitstream.geometry import Geometry, Row
from cm.formats.bitstream.report import Refusal

_IN_ROWS = (0, 1)  # block types whose frames lie in rows of the device
_ROW_PADDING = {Family.SERIES7: 1, Family.ULTRASCALE_PLUS: 4}  # in addition to the one of every run


def _runs(events: native.Events, family: Family) -> Iterator[tuple[int, FrameAddress, int]]:
    """Give word, address and real frames of each FRAMES or MULTI event; a run in pieces grows from its FAR."""
    for word, kind, _, far, count, before, shared in events:
        if kind == native.MULTI:
            yield word, decode_far(far, family), shared
        else:
            yield word, decode_far(far, family), max(1, (before + count) // family.frame_words - 1)


def _last_column(row: Row, address: FrameAddress, frames: int, padding: int) -> int:
    """Return the column of a run's last frame, or the number of columns if it goes past the end of the row."""
    end = row.starts[address.column] + address.minor + frames  # one past the last
    if row.starts[-1] < end <= row.starts[-1] + padding:
        end = row.starts[-1]
    last = address.column
    while last < row.columns and row.starts[last + 1] < end:
        last += 1
    return last


def reach(events: native.Events, family: Family, geometry: Geometry) -> dict[tuple[int, int, int], int]:
    """Return the last column reached from each (block type, row, column) that the geometry knows."""
    found: dict[tuple[int, int, int], int] = {}
    for _, address, frames in _runs(events, family):
        row = geometry.row(address.block_type, address.row)
        if row is not None and address.column < row.columns:
            key = (address.block_type, address.row, address.column)
            padding = _ROW_PADDING[family] if address.block_type in _IN_ROWS else 0
            last = _last_column(row, address, frames, padding)
            found[key] = max(found.get(key, 0), last)
    return found


def check_addresses(events: native.Events, family: Family, geometry: Geometry) -> list[Refusal]:
    """Return a refusal for the first address of a frame that its column does not have."""
    for word, address, _ in _runs(events, family):
        row = geometry.row(address.block_type, address.row)
        if row is not None and address.minor >= row.frames(address.column):
            there = f"has {row.frames(address.column)}" if address.column < row.columns else "does not exist"
            where = f"frame {address.minor} of block type {address.block_type} row {address.row} column"
            return [Refusal(BadPacket.code, f"word {word}: {where} {address.column}, which {there} in this device")]
    return []
