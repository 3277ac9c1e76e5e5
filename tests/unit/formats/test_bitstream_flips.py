# SPDX-License-Identifier: Apache-2.0
"""No single flipped bit in the configuration words of a bitstream with CRCs goes unnoticed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pytest
from bitstream_support import compressed, small, two_sections

from cm.formats.bitstream import BitstreamError, Container, convert, inspect, open_image


def accepted(data: bytes) -> bool:
    try:
        return not inspect(data).problems
    except BitstreamError:
        return False


def survivors(data: bytes, flips: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """The flips (byte, bit) after which the bitstream is still accepted."""
    damaged = bytearray(data)
    for byte, bit in flips:
        damaged[byte] ^= 1 << bit
        if accepted(bytes(damaged)):
            yield byte, bit
        damaged[byte] ^= 1 << bit


def test_every_bit_of_a_small_bitstream_matters() -> None:
    data = small()
    begin = open_image(data).offset
    assert accepted(data)
    assert list(survivors(data, ((byte, bit) for byte in range(begin, len(data)) for bit in range(8)))) == []


@pytest.mark.parametrize("make", [two_sections, compressed, lambda: small(partial=False)])
@pytest.mark.parametrize("first", [0, 5])
def test_a_bit_of_every_byte_matters(make: object, first: int) -> None:
    data = make()  # type: ignore[operator]
    begin = open_image(data).offset
    assert accepted(data)
    assert list(survivors(data, ((byte, (byte + first) % 8) for byte in range(begin, len(data))))) == []


def test_flips_in_a_swapped_bin_matter_too() -> None:
    data = convert(small(), Container.BIN_SWAPPED)
    assert accepted(data)
    assert list(survivors(data, ((byte, byte % 8) for byte in range(len(data))))) == []
