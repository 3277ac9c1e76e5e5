# SPDX-License-Identifier: Apache-2.0
"""`Register` and `RegisterMap`: registers with bits and fields, as `DefaultIP.register_map` gives them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, ClassVar

from cm.client.places import WHOLE
from cm.pynq.mmio import MMIO

_READ_ONLY, _WRITE_ONLY = "read-only", "write-only"
_Infos = Mapping[str, Mapping[str, Any]]


class _Named:
    """What has attributes by the names of a `.hwh`; one that is not there raises AttributeError with those that are."""

    _kind: ClassVar[str]
    _known: Mapping[str, Any]

    def _find(self, name: str) -> Any:
        known = vars(self).get("_known", {})
        if name not in known:
            raise AttributeError(f"no {self._kind} {name!r}; there are: {', '.join(known) or 'none'}")
        return known[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._known]


class Register(_Named):
    """A register of 32 or 64 bits. ``register[7:4]`` has both ends, as in hardware; fields are attributes.

    It is an object, not a number: ``int(register)`` or ``register[:]`` reads it.
    """

    _kind = "field"

    def __init__(
        self,
        address: int,
        width: int = 32,
        buffer: MMIO | None = None,
        access: str = "read-write",
        fields: _Infos | None = None,
    ) -> None:
        """`address` is physical, or, with `buffer`, an offset in that window."""
        if width not in (32, 64):
            raise ValueError("Supported register width is 32 or 64.")
        window, offset = (MMIO(address, width // 8), 0) if buffer is None else (buffer, address)
        known = {  # lowest bit, bits in their place at 0, access
            _attribute(name): (field["bit_offset"], (1 << field["bit_width"]) - 1, field["access"])
            for name, field in (fields or {}).items()
        }
        vars(self).update(address=address, width=width, access=access, _mmio=window, _offset=offset, _known=known)

    def __getitem__(self, bits: int | slice) -> Any:
        """A bit, or bits; from the low end up they come in reverse. ``"write-only"`` where nothing can be read."""
        low, count, reverse = _ends(bits, self.width)
        if self.access == _WRITE_ONLY:
            return self.access
        return _turned(self._mmio.read(self._offset, self.width // 8) >> low & ((1 << count) - 1), count, reverse)

    def __setitem__(self, bits: int | slice, value: Any) -> None:
        """Write a bit, or bits; of a whole register negative numbers too.

        Raises ValueError for a value that does not fit, AttributeError if read-only.
        """
        low, count, reverse = _ends(bits, self.width)
        if self.access == _READ_ONLY:
            raise AttributeError(f"the register at {self.address:#x} is read-only")
        number, mask = int(value), ((1 << count) - 1) << low
        if isinstance(value, float) and number != value:
            raise ValueError(f"{value} is not a whole number")
        if count == self.width and -1 << count - 1 <= number < 0:
            number += 1 << count  # a whole register may hold a signed number
        if not 0 <= number < 1 << count:
            raise ValueError(f"Slicing range cannot represent value {value}: {count} bits hold 0 to {(1 << count) - 1}")
        number = _turned(number, count, reverse) << low
        for shift in range(0, self.width, 32):
            if mask >> shift & WHOLE:
                self._mmio.write_masked(self._offset + shift // 8, number >> shift & WHOLE, mask >> shift & WHOLE)

    def __getattr__(self, name: str) -> Any:
        low, mask, _ = self._find(name)
        if self.access == _WRITE_ONLY:
            return self.access
        return self._mmio.read(self._offset, self.width // 8) >> low & mask

    def __setattr__(self, name: str, value: Any) -> None:
        low, mask, access = self._find(name)
        if access == _READ_ONLY:
            raise AttributeError(f"field {name} is read-only")
        self[low + mask.bit_length() - 1 : low] = value

    def __int__(self) -> int:
        if self.access == _WRITE_ONLY:
            raise TypeError(f"the register at {self.address:#x} is write-only")
        return int(self[:])

    __index__ = __int__

    def __str__(self) -> str:
        return hex(int(self))

    def __repr__(self) -> str:
        whole = self[:]
        shown = [
            f"{name}={_WRITE_ONLY if _WRITE_ONLY in (whole, access) else whole >> low & mask}"
            for name, (low, mask, access) in self._known.items()
        ]
        return f"Register({', '.join(shown) or f'value={whole}'})"


class RegisterMap(_Named):
    """The registers of a block by name; printing it reads all that can be read."""

    _kind = "register"

    def __init__(self, mmio: MMIO, registers: _Infos) -> None:
        known: dict[str, Register] = {}
        for name, info in sorted(registers.items(), key=lambda item: int(item[1]["address_offset"])):
            if info["size"] <= 64:
                width = 64 if info["size"] > 32 else 32
                one = Register(info["address_offset"], width, mmio, info["access"], info["fields"])
                known.setdefault(_attribute(name), one)
        vars(self).update(known, _known=known)

    def __getattr__(self, name: str) -> Any:
        return self._find(name)

    def __setattr__(self, name: str, value: Any) -> None:
        self._find(name)[:] = value

    def __repr__(self) -> str:
        return "RegisterMap {\n" + ",\n".join(f"  {name} = {one!r}" for name, one in self._known.items()) + "\n}"


def _attribute(name: str) -> str:
    return re.sub(r"[^a-zA-Z0-9_]", "_", f"r{name}" if name[:1].isdigit() else name)


def _turned(value: int, count: int, reverse: bool) -> int:
    return int(f"{value:0{count}b}"[::-1], 2) if reverse else value


def _ends(bits: int | slice, width: int) -> tuple[int, int, bool]:
    """The lowest bit, how many, and whether they were named from the low end up."""
    start = stop = bits
    if isinstance(bits, slice):
        if bits.step not in (None, 1, -1):
            raise ValueError("Slicing step is not valid.")
        ends = (0, width - 1) if bits.step == 1 else (width - 1, 0)
        start, stop = (
            (bits.start if bits.start is not None else ends[0]),
            (bits.stop if bits.stop is not None else ends[1]),
        )
    if not (isinstance(start, int) and isinstance(stop, int)):
        raise ValueError("Index must be int or slice.")
    for end in (start, stop):
        if end not in range(width):
            raise ValueError(f"Slicing endpoint {end} not in range 0 - {width - 1}")
    return min(start, stop), abs(start - stop) + 1, start < stop
