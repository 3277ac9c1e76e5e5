# SPDX-License-Identifier: Apache-2.0
"""Frames of 7-series devices as numbers: 101 words of 32 bits, bit b of word w is bit 32 w + b of the number."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import TypeAlias

WORDS = 101
BYTES = 4 * WORDS
ECC_WORD = 50
ECC_MASK = 0x1FFF << 32 * ECC_WORD  # the low 13 bits of word 50 hold the checksum

Frames: TypeAlias = Mapping[int, int]  # frame address (FAR) → frame; one that is missing is all zeros


def from_bytes(data: bytes) -> int:
    """Return a frame of big-endian words, as a bitstream has them (404 bytes), as a number."""
    return int.from_bytes(_turned(data), "little")


def to_bytes(frame: int) -> bytes:
    """Return a frame as the 404 bytes of a bitstream."""
    return _turned(frame.to_bytes(BYTES, "little"))


def _turned(words: bytes) -> bytes:
    """The bytes of each word reversed, without the shim, which a laptop that draws a region does not have."""
    count = len(words) // 4
    return struct.pack(f"<{count}I", *struct.unpack(f">{count}I", words))


def set_bits(number: int) -> Iterator[int]:
    """The positions of the bits that are 1, lowest first."""
    while number:
        low = number & -number
        yield low.bit_length() - 1
        number ^= low


def ecc(frame: int) -> int:
    """Return the 13 bits of checksum that a frame should hold in word 50.

    The device's own correction reads them back; loading does not need them. The sum is a Hamming code:
    each set bit adds its number (which leaves out the powers of two: those are the checksum's own), and bit
    12 makes the number of ones even. The same as Project X-Ray's ``xc7frames2bit`` writes.
    """
    total = 0
    for position in set_bits(frame & ~ECC_MASK):
        word = position >> 5
        total ^= position + (0x1360 if word > 0x25 else 0x1340 if word > 6 else 0x1320)
    return total ^ ((total & 0xFFF).bit_count() & 1) << 12


def with_ecc(frame: int) -> int:
    """Return a frame with its checksum in place."""
    return frame & ~ECC_MASK | ecc(frame) << 32 * ECC_WORD
