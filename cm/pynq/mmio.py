# SPDX-License-Identifier: Apache-2.0
"""`MMIO`: a window of words by address, each of which the loaded configuration describes."""

from __future__ import annotations

from collections.abc import Callable
from operator import index
from typing import Any

import numpy as np

from cm.client.places import WORD
from cm.pynq.board import places


class MMIO:
    """A window of `length` bytes at a physical address.

    A word that the configuration does not describe raises NotFound; limits, leases and rights hold as for its name.
    """

    def __init__(self, base_addr: int, length: int = 4, **_: Any) -> None:
        """Further arguments are PYNQ's; a program has one board."""
        self.base_addr, self.length, self._places = index(base_addr), index(length), places()
        self.array = self._places.words(self.base_addr, self.length)
        self._words: dict[int, Callable[[], int]] = {}  # what reads them, by offset

    def read(self, offset: int = 0, length: int = 4) -> int:
        """`length` (1, 2, 4 or 8) bytes from a word on.

        Raises ValueError, MemoryError for an offset that is no word's, IndexError outside the window.
        """
        if length == WORD:
            if offset not in self._words:
                self._words[offset] = self._places.reader(self._address(offset, WORD))
            return self._words[offset]()
        if length not in (1, 2, 4, 8):
            raise ValueError("MMIO currently only supports 1, 2, 4 and 8-byte reads.")
        address = self._address(offset, max(length, WORD))
        low, mask = self._places.read(address), (1 << 8 * length) - 1
        return (low | self._places.read(address + WORD) << 32 if length == 8 else low) & mask

    def write(self, offset: int, data: Any) -> None:
        """Write a word, or bytes as words. Integers from -2^31 to 2^32 - 1, of numpy too.

        Raises ValueError for others, MemoryError for what is not whole words, IndexError outside the window.
        """
        if not isinstance(data, (bytes, bytearray, memoryview)):
            self._places.write(self._address(offset, WORD), data)
            return
        raw = bytes(data)
        if len(raw) % WORD:
            raise MemoryError("Unaligned write: data length must be multiple of 4.")
        self._address(offset, len(raw))
        self.array[offset // WORD : (offset + len(raw)) // WORD] = np.frombuffer(raw, "<u4")

    def write_masked(self, offset: int, value: int, mask: int) -> None:
        """Write only the bits in `mask` of a word."""
        self._places.write(self._address(offset, WORD), value, mask)

    def _address(self, offset: int, length: int) -> int:
        if offset < 0:
            raise ValueError("Offset cannot be negative.")
        if offset % WORD:
            raise MemoryError("Unaligned access: offset must be multiple of 4.")
        if offset + length > self.length:
            raise IndexError(f"{length} bytes at offset {offset:#x} are not in this window of {self.length:#x} bytes")
        return self.base_addr + offset
