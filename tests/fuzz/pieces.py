# SPDX-License-Identifier: Apache-2.0
"""Several byte strings in one: each with its length before it, so that a mutation moves no border but its own."""

from __future__ import annotations

import struct
from collections.abc import Iterable

_LENGTH = struct.Struct("<H")


def join(pieces: Iterable[bytes]) -> bytes:
    """The one string; pieces of up to 65535 bytes."""
    return b"".join(_LENGTH.pack(len(piece)) + piece for piece in pieces)


def split(data: bytes) -> list[bytes]:
    """The pieces of any string; the last one is what there is of it."""
    found, at = [], 0
    while at + _LENGTH.size <= len(data):
        (length,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        found.append(data[at : at + length])
        at += length
    return found
