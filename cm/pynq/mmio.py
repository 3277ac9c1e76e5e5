# SPDX-License-Identifier: Apache-2.0
"""`MMIO`: a window of words by address, each of which the loaded configuration describes."""

from __future__ import annotations

from collections.abc import Callable
from operator import index
from typing import Any

import numpy as np

from cm.client.errors import BoardClosed, WindowRevoked
from cm.client.places import WHOLE, WORD
from cm.pynq.board import places


class MMIO:
    """A window of `length` bytes at a physical address.

    A word that the configuration does not describe raises NotFound; limits, leases and rights hold as for its name.
    """

    def __init__(self, base_addr: int, length: int = 4, device: Any = None, **_: Any) -> None:
        """`device` is PYNQ's; a program has one board."""
        if base_addr < 0 or length < 0:
            raise ValueError("Base address or length cannot be negative.")
        self.base_addr, self.length, self.device = index(base_addr), index(length), device
        self.array = WordArray(range(self.base_addr, self.base_addr + self.length // WORD * WORD, WORD))
        self._loads: dict[int, Callable[[], int]] = {}

    def read(self, offset: int = 0, length: int = 4, word_order: str = "little") -> int:
        """`length` (1, 2, 4 or 8) bytes from a word on. `word_order`: of 8 bytes, "little" has the low word first.

        Raises ValueError, MemoryError for an offset that is no word's, IndexError outside the window.
        """
        if length == WORD and offset in self._loads:
            try:
                return self._loads[offset]()
            except (WindowRevoked, BoardClosed):
                self._loads.clear()
        if length not in (1, 2, 4, 8):
            raise ValueError("MMIO currently only supports 1, 2, 4 and 8-byte reads.")
        if length == 8 and word_order not in ("big", "little"):
            raise ValueError("MMIO only supports big and little endian.")
        address = self._address(offset, max(length, WORD))
        if length == WORD and (load := places().load(address)) is not None:
            self._loads[index(offset)] = load
            return load()
        low = places().read(address)
        if length < 8:
            return low & ((1 << 8 * length) - 1)
        high = places().read(address + WORD)
        return low << 32 | high if word_order == "big" else high << 32 | low

    def write(self, offset: int, data: Any) -> None:
        """Write a word, or bytes as words. Integers from -2^31 to 2^32 - 1, of numpy too.

        Raises ValueError for others, MemoryError for what is not whole words, IndexError outside the window.
        """
        if not isinstance(data, (bytes, bytearray, memoryview)):
            places().write(self._address(offset, WORD), word(data))
            return
        raw = bytes(data)
        if len(raw) % WORD:
            raise MemoryError("Unaligned write: data length must be multiple of 4.")
        address = self._address(offset, len(raw))
        places().write_all(range(address, address + len(raw), WORD), np.frombuffer(raw, "<u4"))

    def write_masked(self, offset: int, value: int, mask: int) -> None:
        """Write only the bits in `mask` of a word."""
        places().write(self._address(offset, WORD), value, mask)

    def _address(self, offset: int, length: int) -> int:
        if offset < 0:
            raise ValueError("Offset cannot be negative.")
        if offset % WORD:
            raise MemoryError("Unaligned access: offset must be multiple of 4.")
        if offset + length > self.length:
            raise IndexError(f"{length} bytes at offset {offset:#x} are not in this window of {self.length:#x} bytes")
        return self.base_addr + index(offset)


class WordArray:
    """The words of a window by index and slice, as a numpy array has them; reads are copies."""

    def __init__(self, where: range) -> None:
        self._where = where

    def __len__(self) -> int:
        return len(self._where)

    def __getitem__(self, key: int | slice) -> Any:
        if isinstance(key, slice):
            return places().read_all(self._where[key])
        return np.uint32(places().read(self._where[index(key)]))

    def __setitem__(self, key: int | slice, value: Any) -> None:
        if not isinstance(key, slice):
            places().write(self._where[index(key)], word(value))
            return
        where = self._where[key]
        values = np.broadcast_to(np.asarray(value), (len(where),)).tolist()
        places().write_all(where, np.array([word(item) for item in values], "<u4"))


def word(value: Any) -> int:
    """An integer as a word of 32 bits, negative ones as PYNQ has them. Raises ValueError for what is none."""
    try:
        number = index(value)
    except TypeError:
        raise ValueError(f"Data type must be int or bytes, not {type(value).__name__}.") from None
    if not -(1 << 31) <= number <= WHOLE:
        raise ValueError(f"{number} is not a number of 32 bits")
    return number & WHOLE
