# SPDX-License-Identifier: Apache-2.0
"""Frame data of a stream: whole frames, valid addresses, and the footprint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

from cm.bitstream.devices import Family
from cm.bitstream.errors import BadPacket, BitstreamError, FramesIncomplete
from cm.bitstream.geometry import Geometry
from cm.bitstream.reach import reach
from cm.bitstream.report import Footprint, Refusal
from cm.native import bitstream as native

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Frames: TypeAlias = "npt.NDArray[np.int64]"


def _refusal(error: type[BitstreamError], message: str) -> Refusal:
    return Refusal(error.code, message)


def _frames_of(events: native.Events, family: Family) -> Frames:
    """Return how many frames each FRAMES (words over frame size) or MULTI event writes."""
    import numpy as np

    whole = events["count"].astype(np.int64) // family.frame_words
    return np.where(events["kind"] == native.MULTI, events["frames"], whole)


def _distinct(events: native.Events, counts: Frames) -> tuple[npt.NDArray[np.uint32], Frames]:
    """Return each FAR once, with the longest run from it: partial bitstreams write regions twice."""
    import numpy as np

    words, inverse = np.unique(events["value"], return_inverse=True)
    longest = np.zeros(len(words), dtype=np.int64)
    np.maximum.at(longest, inverse, counts)
    return words, longest


def footprint(events: native.Events, family: Family, geometry: Geometry | None = None) -> tuple[Footprint, ...]:
    """Return the columns that FAR was set to before frames came, and how many came, in FAR order."""
    import numpy as np

    layout = family.far
    fars, counts = _distinct(events, _frames_of(events, family))
    shift = layout.column[0]
    columns, inverse = np.unique(fars >> shift, return_inverse=True)
    totals = np.bincount(inverse, weights=counts, minlength=len(columns)).astype(np.int64)
    words = columns.astype(np.int64) << shift
    fields = (words >> at & ((1 << width) - 1) for at, width in (layout.block_type, layout.row, layout.column))
    reached = reach(events, family, geometry) if geometry else {}
    entries = zip(*(field.tolist() for field in fields), totals.tolist(), strict=True)
    return tuple(
        Footprint(block_type, row, column, frames, reached.get((block_type, row, column)))
        for block_type, row, column, frames in entries
    )


def total_frames(events: native.Events, family: Family) -> int:
    """Return the frames that all runs write together."""
    return int(_frames_of(events, family).sum())


def frames_between(events: native.Events, family: Family, first: int, last: int) -> int:
    """Return the frames written by packets from word `first` up to word `last`."""
    words = events["word"]
    return total_frames(events[(words >= first) & (words < last)], family)


def check_frames(events: native.Events, family: Family) -> list[Refusal]:
    """Return what is wrong with the frame packets: parts of frames, addresses with unknown bits, MFWR data."""
    import numpy as np

    problems = []
    runs = events[events["kind"] == native.FRAMES]
    shared = events[events["kind"] == native.MULTI]
    if not len(runs):
        problems.append(_refusal(FramesIncomplete, "no frame data: the bitstream would configure nothing"))
    for row in runs[runs["count"] % family.frame_words != 0][:1]:
        problems.append(
            _refusal(
                FramesIncomplete,
                f"word {row['word']}: {row['count']} words of frame data at FAR {row['value']:08X} are not a whole "
                f"frames of {family.frame_words} words",
            )
        )
    for row in events[(events["value"] & np.uint32(~family.far.used & 0xFFFFFFFF)) != 0][:1]:
        problems.append(_refusal(BadPacket, f"word {row['word']}: {row['value']:08X} is not a frame address"))
    for row in shared[shared["extra"] != 0][:1]:
        problems.append(_refusal(BadPacket, f"word {row['word']}: an MFWR packet carries data other than zeros"))
    return problems


def check_fills(counts: Sequence[int], family: Family) -> list[Refusal]:
    """Zero words between packets stand only in debug bitstreams: two frames of them after a row."""
    odd = Counter(count for count in counts if count % (2 * family.frame_words))
    return [_refusal(BadPacket, f"{count} zero words between packets are not padding frames") for count in odd]
