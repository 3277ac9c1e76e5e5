# SPDX-License-Identifier: Apache-2.0
"""What the bits of a register mean: numbers with a sign, with a binary point, or IEEE 754's."""

from __future__ import annotations

import struct

from cm.errors import InvalidRequest
from cm.wire.messages.status import RegisterInfo

_FLOATS = {"float32": ("<f", "<I"), "float64": ("<d", "<Q")}


def decoded(info: RegisterInfo, bits: int) -> int | float:
    """The value that a register's bits stand for."""
    if info.type in _FLOATS:
        number, word = _FLOATS[info.type]
        value: float = struct.unpack(number, struct.pack(word, bits))[0]
        return value
    signed = bits - (1 << info.width) if info.type == "int" and bits >> (info.width - 1) else bits
    return signed / (1 << info.fraction) if info.fraction else signed


def encoded(info: RegisterInfo, value: float) -> int:
    """The bits that stand for a value; fixed point is rounded to its last bit.

    Raises InvalidRequest for a number that the register cannot hold.
    """
    if info.type in _FLOATS:
        number, word = _FLOATS[info.type]
        try:
            bits: int = struct.unpack(word, struct.pack(number, value))[0]
        except OverflowError:
            raise InvalidRequest(f"register {info.name!r}: {value} is too large for {info.type}") from None
        return bits
    whole = round(value * (1 << info.fraction)) if info.fraction else value
    if whole != int(whole):
        raise InvalidRequest(f"register {info.name!r} holds whole numbers, not {value}")
    low, high = (-(1 << (info.width - 1)), 1 << (info.width - 1)) if info.type == "int" else (0, 1 << info.width)
    if not low <= whole < high:
        scale = 1 << info.fraction
        ends = f"{low / scale:g} to {(high - 1) / scale:g}"
        raise InvalidRequest(f"register {info.name!r} holds {ends}, not {value}")
    return int(whole) & ((1 << info.width) - 1)
