# SPDX-License-Identifier: Apache-2.0
"""Frame data of a stream: whole frames, valid addresses, and the footprint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from cm.device.native import bitstream as native
from cm.formats.bitstream.devices import Family
from cm.formats.bitstream.errors import BadPacket, BitstreamError, FramesIncomplete
from cm.formats.bitstream.geometry import Geometry
from cm.formats.bitstream.reach import reach
from cm.formats.bitstream.report import Footprint, Refusal


def _refusal(error: type[BitstreamError], message: str) -> Refusal:
    return Refusal(error.code, message)


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
    layout = family.far
    shift = layout.column[0]
    totals: Counter[int] = Counter()
    for far, count in _longest(events, family).items():
        totals[far >> shift << shift] += count
    reached = reach(events, family, geometry) if geometry else {}
    entries = []
    for word, count in sorted(totals.items()):
        block_type, row, column = (
            word >> at & ((1 << width) - 1) for at, width in (layout.block_type, layout.row, layout.column)
        )
        entries.append(Footprint(block_type, row, column, count, reached.get((block_type, row, column))))
    return tuple(entries)


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
        problems["none"] = _refusal(FramesIncomplete, message)
    unknown = ~family.far.used
    for at, kind, _, far, count, extra, _ in events:
        if kind == native.FRAMES and count % family.frame_words:
            message = f"word {at}: {count} words of frame data at FAR {far:08X} are not whole "
            problems.setdefault("part", _refusal(FramesIncomplete, f"{message}frames of {family.frame_words} words"))
        elif kind == native.MULTI and extra:
            message = f"word {at}: an MFWR packet carries data other than zeros"
            problems.setdefault("data", _refusal(BadPacket, message))
        if far & unknown:
            problems.setdefault("far", _refusal(BadPacket, f"word {at}: {far:08X} is not a frame address"))
    return [problems[key] for key in ("none", "part", "far", "data") if key in problems]


def check_fills(counts: Sequence[int], family: Family) -> list[Refusal]:
    """Zero words between packets stand only in debug bitstreams: two frames of them after a row."""
    odd = Counter(count for count in counts if count % (2 * family.frame_words))
    return [_refusal(BadPacket, f"{count} zero words between packets are not padding frames") for count in odd]
