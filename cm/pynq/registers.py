# SPDX-License-Identifier: Apache-2.0
"""`Register` and `RegisterMap`: registers with bits and fields, as `DefaultIP.register_map` gives them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, TypeVar

from cm.client.places import WHOLE
from cm.pynq.mmio import MMIO

_READ_ONLY, _WRITE_ONLY = "read-only", "write-only"
_T = TypeVar("_T")
_Infos = Mapping[str, Mapping[str, Any]]


class Register:
    """A register of 32 or 64 bits. ``register[7:4]`` has both ends, as in hardware; fields are attributes.

    It is an object, not a number: ``int(register)`` or ``register[:]`` reads it.
    """

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
        named = {_attribute(name): field for name, field in (fields or {}).items()}
        vars(self).update(address=address, width=width, access=access, _mmio=window, _offset=offset, _fields=named)
        places = {name: (field["bit_offset"], (1 << field["bit_width"]) - 1) for name, field in named.items()}
        vars(self)["_places"] = {} if access == _WRITE_ONLY else places

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
        if count == self.width and -1 << count - 1 <= number < 0:
            number += 1 << count  # a whole register may hold a signed number
        if not 0 <= number < 1 << count:
            raise ValueError(f"Slicing range cannot represent value {value}: {count} bits hold 0 to {(1 << count) - 1}")
        number = _turned(number, count, reverse) << low
        for shift in range(0, self.width, 32):
            if mask >> shift & WHOLE:
                self._mmio.write_masked(self._offset + shift // 8, number >> shift & WHOLE, mask >> shift & WHOLE)

    def __getattr__(self, name: str) -> Any:
        place = vars(self).get("_places", {}).get(name)
        if place is None:
            return self[_bits(self._field(name))]
        return self._mmio.read(self._offset, self.width // 8) >> place[0] & place[1]

    def __setattr__(self, name: str, value: Any) -> None:
        if self._field(name)["access"] == _READ_ONLY:
            raise AttributeError(f"field {name} is read-only")
        self[_bits(self._field(name))] = value

    def __int__(self) -> int:
        if self.access == _WRITE_ONLY:
            raise TypeError(f"the register at {self.address:#x} is write-only")
        return int(self[:])

    __index__ = __int__

    def __str__(self) -> str:
        return hex(int(self))

    def __repr__(self) -> str:
        whole, found = self[:], []
        for name, field in self._fields.items():
            hidden = _WRITE_ONLY in (whole, field["access"])
            value = _WRITE_ONLY if hidden else whole >> field["bit_offset"] & ((1 << field["bit_width"]) - 1)
            found.append(f"{name}={value}")
        return f"Register({', '.join(found) or f'value={whole}'})"

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._fields]

    def _field(self, name: str) -> Mapping[str, Any]:
        fields: _Infos = vars(self).get("_fields", {})
        return _found("field", name, fields)


class RegisterMap:
    """The registers of a block by name; printing it reads all that can be read."""

    def __init__(self, mmio: MMIO, registers: _Infos) -> None:
        found: dict[str, Register] = {}
        for name, info in sorted(registers.items(), key=lambda item: int(item[1]["address_offset"])):
            width = 64 if info["size"] > 32 else 32
            one = Register(info["address_offset"], width, mmio, info["access"], info["fields"])
            if info["size"] <= 64:
                found.setdefault(_attribute(name), one)
        vars(self).update(found, _registers=found)

    def __getattr__(self, name: str) -> Register:
        registers: Mapping[str, Register] = vars(self).get("_registers", {})
        return _found("register", name, registers)

    def __setattr__(self, name: str, value: Any) -> None:
        _found("register", name, vars(self)["_registers"])[:] = value

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *vars(self)["_registers"]]

    def __repr__(self) -> str:
        lines = [f"  {name} = {one!r}" for name, one in vars(self)["_registers"].items()]
        return "RegisterMap {\n" + ",\n".join(lines) + "\n}"


def _found(kind: str, name: str, known: Mapping[str, _T]) -> _T:
    if name not in known:
        raise AttributeError(f"no {kind} {name!r}; there are: {', '.join(known) or 'none'}")
    return known[name]


def _attribute(name: str) -> str:
    return re.sub(r"[^a-zA-Z0-9_]", "_", f"r{name}" if name[:1].isdigit() else name)


def _bits(field: Mapping[str, Any]) -> slice:
    return slice(field["bit_offset"] + field["bit_width"] - 1, field["bit_offset"])


def _turned(value: int, count: int, reverse: bool) -> int:
    return int(f"{value:0{count}b}"[::-1], 2) if reverse else value


def _ends(bits: int | slice, width: int) -> tuple[int, int, bool]:
    """The lowest bit, how many, and whether they were named from the low end up."""
    if isinstance(bits, slice):
        if bits.step not in (None, 1, -1):
            raise ValueError("Slicing step is not valid.")
        ends = (0, width - 1) if bits.step == 1 else (width - 1, 0)
        start, stop = (
            end if given is None else given for given, end in zip((bits.start, bits.stop), ends, strict=True)
        )
    else:
        start = stop = bits
    for end in (start, stop):
        if not isinstance(end, int):
            raise ValueError("Index must be int or slice.")
        if end not in range(width):
            raise ValueError(f"Slicing endpoint {end} not in range 0 - {width - 1}")
    return min(start, stop), abs(start - stop) + 1, start < stop
