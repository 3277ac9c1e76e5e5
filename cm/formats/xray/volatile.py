# SPDX-License-Identifier: Apache-2.0
"""The bits of frames that the fabric changes by itself, so that a readback cannot be expected to hold what was loaded.

UG470 (readback, mask files) names them: contents of look-up tables that are memory or shift registers, contents of
block RAM, and the cells that hold what a register begins with, which a capture overwrites.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TypeAlias

from cm.formats.xray.database import Database
from cm.formats.xray.frames import BYTES, Frames
from cm.formats.xray.tiles import Bit, Segbits, Segment

Masks: TypeAlias = Mapping[int, "int | None"]  # frame address → bits that must not be compared

_CONTENTS = 1  # block type of the frames that hold what is in block RAM
_WHOLE = (1 << 8 * BYTES) - 1
_WRITTEN = re.compile(r"(SLICEM_X\d\.[A-D]LUT)\.(?:RAM|SRL)")
_CAPTURED = re.compile(r".*\.(?:[A-D]5?FF\.ZINI|IFF\.ZINIT_Q\d|ZINIT_[OT]Q)")


def volatile_bits(database: Database, frames: Frames) -> Masks:
    """Return, for each of these frames by its address, the bits that may change while the design runs.

    `frames` are what was loaded, of whole columns: what says that a table is memory stands in other frames than its
    contents. None: the database knows no tile in this frame, or not all that have bits in it (XADC, configuration
    centre), and nothing can be said about it.

    The first call for a database reads its grid of tiles: half a second and some 30 MB of memory. Raises XrayError.
    """
    masks: dict[int, int | None] = {address: _WHOLE for address in frames if address >> 23 & 7 == _CONTENTS}
    unknown = set()
    tables: dict[tuple[str, str], _Table] = {}
    for segment in (segment for tile in database.tiles.values() for segment in tile.segments):
        here = frames.keys() & set(range(segment.base, segment.base + segment.frames))
        if not here:
            continue
        key = segment.kind, segment.block
        table = tables.get(key) or tables.setdefault(key, _Table(database.segbits(*key)))
        if not table.known:
            unknown |= here
        for address in here:
            masks.setdefault(address, 0)
        for address, position in table.volatile(segment, frames):
            if address in here:
                masks[address] = (masks[address] or 0) | 1 << position
    return {address: None if address in unknown else masks.get(address) for address in frames}


class _Table:
    """What may change in a kind of tile."""

    def __init__(self, segbits: Segbits) -> None:
        self.known = bool(segbits.features)
        self._always = [bit for name, bits in segbits.features.items() if _CAPTURED.fullmatch(name) for bit in bits]
        self._written = [
            (bits, [segbits.features[f"{found[1]}.INIT[{number}]"][0] for number in range(64)])
            for name, bits in segbits.features.items()
            if (found := _WRITTEN.fullmatch(name))
        ]

    def volatile(self, segment: Segment, frames: Frames) -> Iterator[tuple[int, int]]:
        """(Frame address, bit of the frame) of a tile's bits that may change."""
        found = list(self._always)
        for wanted, contents in self._written:
            if all(_value(segment, frames, bit) == bit.value for bit in wanted):
                found += contents
        for bit in found:
            if segment.holds(bit):
                yield segment.base + bit.frame, bit.position + segment.shift


def _value(segment: Segment, frames: Frames, bit: Bit) -> bool:
    return bool(frames.get(segment.base + bit.frame, 0) >> (bit.position + segment.shift) & 1)
