# SPDX-License-Identifier: Apache-2.0
"""The CRC of configuration words, by folding: independent of `csrc/bitstream_crc.c`, so that each checks the other.

CRC-32C takes in 37 bits for each word: the word, then the five bits of the register's address, all
least significant first (UG470). One word turns the CRC c into ``step(c ^ word) ^ five(register)``,
and `step` is linear over bits. So the effect of words can be computed for each by itself, and folded in pairs: the
left half goes through `step` once for each word that follows it.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Words: TypeAlias = NDArray[np.uint32]

_POLYNOMIAL = 0x82F63B78
_FEW = 8  # words that are taken one by one: beyond that, folding and remembering pay off


def _shift(value: int, bits: int) -> int:
    for _ in range(bits):
        value = value >> 1 ^ (_POLYNOMIAL if value & 1 else 0)
    return value


_EIGHT = tuple(_shift(value, 8) for value in range(256))
_FIVE = tuple(_shift(value, 5) for value in range(32))


def step(crc: int, register: int, word: int) -> int:
    """Return the CRC after one word written to a register."""
    crc ^= word
    crc = crc >> 8 ^ _EIGHT[crc & 0xFF]
    crc = crc >> 8 ^ _EIGHT[crc & 0xFF]
    crc = crc >> 8 ^ _EIGHT[crc & 0xFF]
    crc = crc >> 8 ^ _EIGHT[crc & 0xFF] ^ register
    return crc >> 5 ^ _FIVE[crc & 0x1F]


@cache
def _tables(power: int) -> Words:
    """Return four tables of 256 for `step` of 2**`power` zero words, one for each byte of the CRC."""
    import numpy as np

    if power == 0:
        columns = [step(1 << bit, 0, 0) for bit in range(32)]
    else:
        half = _tables(power - 1)
        bits = np.left_shift(np.uint32(1), np.arange(32, dtype=np.uint32))
        columns = [int(column) for column in _apply(half, _apply(half, bits))]
    tables = np.zeros((4, 256), dtype=np.uint32)
    for byte in range(4):
        for bit in range(8):
            tables[byte][np.arange(256) >> bit & 1 == 1] ^= np.uint32(columns[8 * byte + bit])
    return tables


def _apply(tables: Words, values: Words) -> Words:
    low: Words = tables[0][values & 0xFF] ^ tables[1][values >> 8 & 0xFF]
    high: Words = tables[2][values >> 16 & 0xFF] ^ tables[3][values >> 24]
    low ^= high
    return low


def run(crc: int, register: int, words: Words) -> int:
    """Return the CRC after many words written to a register."""
    import numpy as np

    if len(words) < _FEW:
        for word in words.tolist():
            crc = step(crc, register, word)
        return crc
    values = words.astype(np.uint32)
    values[0] ^= np.uint32(crc)
    # Zeros in front change nothing, as their contribution is zero.
    parts = _apply(_tables(0), values) ^ np.uint32(_FIVE[register])
    size = 1 << (len(parts) - 1).bit_length()
    parts = np.concatenate((np.zeros(size - len(parts), dtype=np.uint32), parts))
    power = 0
    while len(parts) > 1:
        parts = _apply(_tables(power), parts[0::2]) ^ parts[1::2]
        power += 1
    return int(parts[0])


class Known:
    """`run`, which remembers results for long data: a board is loaded with the same few bitstreams again and again.

    Data is identified by Python's own hash, whose key is new in each process: a digest that withstands attackers takes
    four times as long, and a simulated board has no attackers.
    """

    def __init__(self, limit: int = 4096) -> None:
        self._limit = limit
        self._found: dict[tuple[int, int, int, int], int] = {}

    def run(self, crc: int, register: int, words: Words) -> int:
        """Return the CRC after many words written to a register."""
        if len(words) < _FEW:
            return run(crc, register, words)
        key = (crc, register, len(words), hash(words.tobytes()))
        if key not in self._found:
            if len(self._found) >= self._limit:
                del self._found[next(iter(self._found))]
            self._found[key] = run(crc, register, words)
        return self._found[key]
