# SPDX-License-Identifier: Apache-2.0
"""Windows of words that the loaded configuration describes: `MMIO` by address, `RegisterMap` by name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from operator import index
from typing import Any

import numpy as np

from cm.client.places import WHOLE, WORD
from cm.pynq.board import places

_READ_ONLY, _WRITE_ONLY = "read-only", "write-only"


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


class Named:
    """What has attributes by the names of a `.hwh`; one that is not there raises AttributeError with those that are."""

    _known: Mapping[str, Any] = {}

    def _inside(self) -> Mapping[str, Any]:
        return self._known

    def _find(self, name: str) -> Any:
        known = self._inside()
        if name not in known:
            raise AttributeError(f"{type(self).__name__} has no {name!r}; there are: {', '.join(known) or 'none'}")
        return known[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._inside()]


class Register(Named):
    """A register of 32 or 64 bits. ``register[7:4]`` has both ends, as in hardware; fields are attributes.

    It is an object, not a number: ``int(register)`` or ``register[:]`` reads it.
    """

    def __init__(self, mmio: MMIO, info: Mapping[str, Any]) -> None:
        """`info` is an entry of ``ip_dict[...]["registers"]``, of the block in that window."""
        fields = info["fields"].items()
        known = {_attribute(name): (one["bit_offset"], one["bit_width"], one["access"]) for name, one in fields}
        width, at = 64 if info["size"] > 32 else 32, info["address_offset"]
        vars(self).update(address=at, width=width, access=info["access"], _mmio=mmio, _known=known)

    def __getitem__(self, bits: int | slice) -> Any:
        """A bit, or bits. ``"write-only"`` where nothing can be read."""
        return self._read(*_ends(bits, self.width))

    def __setitem__(self, bits: int | slice, value: Any) -> None:
        """Write a bit, or bits; of a whole register negative numbers too.

        Raises ValueError for a value that does not fit, AttributeError if read-only.
        """
        low, count = _ends(bits, self.width)
        if self.access == _READ_ONLY:
            raise AttributeError(f"the register at {self.address:#x} is read-only")
        number, mask = int(value), ((1 << count) - 1) << low
        if isinstance(value, float) and number != value:
            raise ValueError(f"{value} is not a whole number")
        if count == self.width and -1 << count - 1 <= number < 0:
            number += 1 << count  # a whole register may hold a signed number
        if not 0 <= number < 1 << count:
            raise ValueError(f"Slicing range cannot represent value {value}: {count} bits hold 0 to {(1 << count) - 1}")
        for shift in range(0, self.width, 32):
            if part := mask >> shift & WHOLE:
                self._mmio.write_masked(self.address + shift // 8, number << low >> shift & WHOLE, part)

    def _read(self, low: int, count: int) -> Any:
        if self.access == _WRITE_ONLY:
            return self.access
        return self._mmio.read(self.address, self.width // 8) >> low & ((1 << count) - 1)

    def __getattr__(self, name: str) -> Any:
        low, count, _ = self._find(name)
        return self._read(low, count)

    def __setattr__(self, name: str, value: Any) -> None:
        low, count, access = self._find(name)
        if access == _READ_ONLY:
            raise AttributeError(f"field {name} is read-only")
        self[low + count - 1 : low] = value

    def __int__(self) -> int:
        return int(self[:])

    __index__ = __int__

    def __str__(self) -> str:
        return hex(int(self))

    def __repr__(self) -> str:
        whole = self[:]
        shown = [
            f"{name}={_WRITE_ONLY if _WRITE_ONLY in (whole, access) else whole >> low & ((1 << count) - 1)}"
            for name, (low, count, access) in self._known.items()
        ]
        return f"Register({', '.join(shown) or f'value={whole}'})"


class RegisterMap(Named):
    """The registers of a block by name; printing it reads all that can be read."""

    def __init__(self, mmio: MMIO, registers: Mapping[str, Mapping[str, Any]]) -> None:
        known: dict[str, Register] = {}
        for name, info in sorted(registers.items(), key=lambda item: int(item[1]["address_offset"])):
            if info["size"] <= 64:
                known.setdefault(_attribute(name), Register(mmio, info))
        vars(self).update(known, _known=known)

    __getattr__ = Named._find

    def __setattr__(self, name: str, value: Any) -> None:
        self._find(name)[:] = value

    def __repr__(self) -> str:
        return "RegisterMap {\n" + ",\n".join(f"  {name} = {one!r}" for name, one in self._known.items()) + "\n}"


def _attribute(name: str) -> str:
    return re.sub(r"[^a-zA-Z0-9_]", "_", f"r{name}" if name[:1].isdigit() else name)


def _ends(bits: int | slice, width: int) -> tuple[int, int]:
    """The lowest bit, and how many."""
    start = stop = bits
    if isinstance(bits, slice):
        start, stop = width - 1 if bits.start is None else bits.start, bits.stop or 0
    if not (isinstance(start, int) and isinstance(stop, int) and 0 <= stop <= start < width):
        raise ValueError(f"bits {start} to {stop} are not in range {width - 1} to 0, the high end first")
    return stop, start - stop + 1
