# SPDX-License-Identifier: Apache-2.0
"""Frame addresses: FAR words decoded and encoded."""

from __future__ import annotations

from dataclasses import dataclass

from cm.formats.bitstream.devices import Family


@dataclass(frozen=True, slots=True, order=True)
class FrameAddress:
    """Where a frame lies. On 7-series bit 5 of ``row`` is the half: bottom rows are 32 and up."""

    block_type: int
    row: int
    column: int
    minor: int = 0


def _take(word: int, field: tuple[int, int]) -> int:
    shift, width = field
    return word >> shift & ((1 << width) - 1)


def decode_far(word: int, family: Family) -> FrameAddress:
    """Return the frame address in a FAR word."""
    layout = family.far
    return FrameAddress(
        _take(word, layout.block_type), _take(word, layout.row), _take(word, layout.column), _take(word, layout.minor)
    )


def encode_far(address: FrameAddress, family: Family) -> int:
    """Return the FAR word of a frame address; ValueError if a field does not fit."""
    layout = family.far
    pairs = (
        (address.block_type, layout.block_type),
        (address.row, layout.row),
        (address.column, layout.column),
        (address.minor, layout.minor),
    )
    word = 0
    for value, (shift, width) in pairs:
        if not 0 <= value < 1 << width:
            raise ValueError(
                f"{address} does not fit a frame address of {family.label}: {value} needs over {width} bits"
            )
        word |= value << shift
    return word
