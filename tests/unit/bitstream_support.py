# SPDX-License-Identifier: Apache-2.0
"""Small bitstreams for tests, and a CRC written independently of the one under test."""

from __future__ import annotations

import hashlib
import struct

from cm.formats.bitstream import FrameAddress, FrameRun, SharedFrame, assemble
from cm.formats.bitstream.container import BitHeader, pack_bit

FRAME_BYTES = 404  # 7-series
HERE = FrameAddress(0, 0, 26)
HEADER = BitHeader("top", (("UserID", "0XFFFFFFFF"), ("PARTIAL", "TRUE")), "7z020clg400", "2024/01/01", "00:00:00")


def frames(count: int, seed: bytes = b"frames") -> bytes:
    """`count` frames of 7-series with unstructured contents."""
    return hashlib.shake_128(seed).digest(count * FRAME_BYTES)


def small(**options: object) -> bytes:
    """The smallest bitstream: one frame for an xc7z020."""
    return assemble("xc7z020", [FrameRun(HERE, frames(1))], **options)  # type: ignore[arg-type]


def compressed() -> bytes:
    """A bitstream that writes one frame to three addresses."""
    addresses = (HERE, FrameAddress(0, 0, 26, 1), FrameAddress(0, 3, 2))
    return assemble("xc7z020", [SharedFrame(frames(1), addresses)])


def two_sections() -> bytes:
    """A bitstream of two sections."""
    runs = [FrameRun(HERE, frames(1)), FrameRun(FrameAddress(1, 2, 3), frames(2, b"more"))]
    return assemble("xc7z020", runs, sections=2)


def bit(*words: int) -> bytes:
    """A `.bit` of exactly these configuration words, behind the sync word."""
    return pack_bit(HEADER, struct.pack(f">{len(words) + 2}I", 0xFFFFFFFF, 0xAA995566, *words))


def slow_crc(register: int, words: list[int], crc: int = 0) -> int:
    """CRC-32C over 37 bits a word, one bit at a time, least significant first, as UG470 draws it."""
    for word in words:
        for position in range(37):
            bit_in = (word | register << 32) >> position & 1
            feedback = (crc & 1) ^ bit_in
            crc >>= 1
            if feedback:
                crc ^= 0x82F63B78
    return crc
