# SPDX-License-Identifier: Apache-2.0
"""The register map that Vitis HLS makes of arguments on an AXI4-Lite slave (UG1399, "S_AXILITE Offset")."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from cm.design.hdl.hls_types import Packet

FIRST = 0x10  # after control, interrupt enable and interrupt status, whose addresses are reserved even if unused


@dataclass(frozen=True, slots=True)
class Arg:
    """An argument: `said`: the settings of its pragma; `indirect`: it is a pointer or reference."""

    name: str
    width: int
    indirect: bool
    mode: str
    said: Mapping[str, str]
    writes: bool
    reads: bool
    packet: Packet | None


@dataclass(frozen=True, slots=True)
class Place:
    """A register: `offset` of its first word, `bits`; `output`: the function writes it."""

    name: str
    offset: int
    bits: int
    output: bool


def places(args: Sequence[Arg]) -> Iterator[Place]:
    """Where each argument is: its words, then one word that is reserved or holds the valid flag of an output."""
    offset = FIRST
    for arg in args:
        pointer = arg.mode == "m_axi"
        bits = 64 if pointer else arg.width
        words = -(-bits // 32)
        output = arg.indirect and arg.writes and not pointer
        if output and arg.reads:
            yield Place(f"{arg.name}_i", offset, bits, False)
            offset += 4 * (words + 1)
            yield Place(f"{arg.name}_o", offset, bits, True)
        else:
            yield Place(arg.name, offset, bits, output)
        offset += 4 * (words + 1)


def lite_bits(args: Sequence[Arg]) -> int:
    """Bits of the slave's address."""
    last = FIRST
    for place in places(args):
        last = place.offset + 4 * (-(-place.bits // 32) + 1)
    return max(4, (last - 1).bit_length())
