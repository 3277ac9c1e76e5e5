# SPDX-License-Identifier: Apache-2.0
"""Frame data of a stream: whole frames, valid addresses, how far they reach, and the footprint.

A run goes on into the columns behind its address. The last frame that is written only pushes the
one before it out of the frame buffer, and where a row ends two more do (UG470; on UltraScale+ up to
four were seen in Vivado's files), so these are not frames of the next column.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from cm.device.native import bitstream as native
from cm.formats.bitstream.errors import BadPacket, FramesIncomplete
from cm.formats.bitstream.geometry import IN_ROWS, FrameAddress, Geometry, Row, decode_far
from cm.formats.bitstream.idcodes import Family
from cm.formats.bitstream.inspection_report import Footprint, Refusal

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
    if end <= row.starts[-1] + padding:
        end = min(end, row.starts[-1])
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
            padding = _ROW_PADDING[family] if address.block_type in IN_ROWS else 0
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
            return [Refusal.of(BadPacket, f"word {word}: {where} {address.column}, which {there} in this device")]
    return []


def _frames_of(event: native.Event, family: Family) -> int:
    """Return how many frames a FRAMES (words over frame size) or MULTI event writes."""
    return event.frames if event.kind == native.MULTI else event.count // family.frame_words


def _longest(events: native.Events, family: Family) -> dict[int, int]:
    """Return the longest run from each FAR: partial bitstreams write regions twice."""
    longest: dict[int, int] = {}
    for event in events:
        longest[event.value] = max(longest.get(event.value, 0), _frames_of(event, family))
    return longest


def footprint(events: native.Events, family: Family, geometry: Geometry | None = None) -> tuple[Footprint, ...]:
    """Return the columns that FAR was set to before frames came, and how many came, in FAR order."""
    totals: Counter[tuple[int, int, int]] = Counter()
    for far, count in _longest(events, family).items():
        totals[decode_far(far, family)[:3]] += count
    reached = reach(events, family, geometry) if geometry else {}
    return tuple(Footprint(*column, count, reached.get(column)) for column, count in sorted(totals.items()))


def total_frames(events: native.Events, family: Family) -> int:
    """Return the frames that all runs write together."""
    return sum(_frames_of(event, family) for event in events)


def frames_between(events: native.Events, family: Family, first: int, last: int) -> int:
    """Return the frames written by packets from word `first` up to word `last`."""
    return sum(_frames_of(event, family) for event in events if first <= event.word < last)


def check_frames(events: native.Events, family: Family) -> list[Refusal]:
    """Return what is wrong with the frame packets: parts of frames, addresses with unknown bits, MFWR data."""
    problems: dict[str, Refusal] = {}  # the first of each kind
    if native.FRAMES not in events.kinds:
        message = "no frame data: the bitstream would configure nothing"
        problems["none"] = Refusal.of(FramesIncomplete, message)
    unknown = ~family.far.used
    for at, kind, _, far, count, extra, _ in events:
        if kind == native.FRAMES and count % family.frame_words:
            message = f"word {at}: {count} words of frame data at FAR {far:08X} are not whole "
            problems.setdefault("part", Refusal.of(FramesIncomplete, f"{message}frames of {family.frame_words} words"))
        elif kind == native.MULTI and extra:
            message = f"word {at}: an MFWR packet carries data other than zeros"
            problems.setdefault("data", Refusal.of(BadPacket, message))
        if far & unknown:
            problems.setdefault("far", Refusal.of(BadPacket, f"word {at}: {far:08X} is not a frame address"))
    return [problems[key] for key in ("none", "part", "far", "data") if key in problems]


def check_fills(counts: Sequence[int], family: Family) -> list[Refusal]:
    """Zero words between packets stand only in debug bitstreams: two frames of them after a row."""
    odd = Counter(count for count in counts if count % (2 * family.frame_words))
    return [Refusal.of(BadPacket, f"{count} zero words between packets are not padding frames") for count in odd]
