# SPDX-License-Identifier: Apache-2.0
"""Registers and fields by name: which exist, and what may be written to them. Touches no hardware."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping

from cm.manager.errors import AccessDenied, OutOfRange, UnknownRegister
from cm.schema.model import Access, BitField, Register
from cm.wire.messages.requests import RegWrite


def split_name(name: str) -> tuple[str, str | None]:
    """``"control.enable"`` → register, field."""
    register, dot, field = name.partition(".")
    return register, field if dot else None


def _nowhere() -> str:
    return ""


def find(
    registers: Mapping[str, Register], name: str, elsewhere: Callable[[], str] = _nowhere
) -> tuple[Register, BitField | None]:
    """The register, and the field if one is named.

    Raises UnknownRegister with the nearest names, or with what `elsewhere` says of other modes.
    """
    register_name, field_name = split_name(name)
    register = registers.get(register_name)
    if register is None:
        raise UnknownRegister(
            f"no register {register_name!r} in this mode{elsewhere() or _nearest(register_name, registers)}"
        )
    if field_name is None:
        return register, None
    field = register.fields.get(field_name)
    if field is None:
        raise UnknownRegister(
            f"register {register_name!r} has no field {field_name!r}{_nearest(field_name, register.fields)}"
        )
    return register, field


def _nearest(name: str, known: Mapping[str, object]) -> str:
    close = difflib.get_close_matches(name, known, n=3)
    if close:
        return f"; did you mean {' or '.join(map(repr, close))}?"
    return f"; there are {', '.join(sorted(known))}" if known else "; there are none"


def checked_write(
    registers: Mapping[str, Register], write: RegWrite, elsewhere: Callable[[], str] = _nowhere
) -> tuple[Register, int, int]:
    """A write → register, value, mask in the register's place; refuses what must not be written.

    Raises UnknownRegister, AccessDenied or OutOfRange; nothing was touched.
    """
    register, field = find(registers, write.name, elsewhere)
    if register.access is Access.RO:
        raise AccessDenied(f"register {register.name!r} is read-only")
    full = (1 << register.width) - 1
    if write.named:
        write = _by_name(write, field)
    if field is not None:
        limit = (1 << field.width) - 1
        if write.mask is not None:
            raise OutOfRange(f"{write.name!r} is a field: give a value or a mask, not both")
        in_range(write.name, write.value, 0, limit)
        return register, write.value << field.lsb, field.mask
    in_range(write.name, write.value, 0, full)
    if write.mask is None:
        in_range(write.name, write.value, register.minimum or 0, full if register.maximum is None else register.maximum)
        return register, write.value, full
    if not 0 <= write.mask <= full:
        raise OutOfRange(f"register {write.name!r}: mask {write.mask:#x} does not fit {register.width} bits")
    return register, write.value & write.mask, write.mask


def _by_name(write: RegWrite, field: BitField | None) -> RegWrite:
    """A write that names a value, with the value in numbers. Raises OutOfRange."""
    names = field.values if field is not None else {}
    if not names:
        raise OutOfRange(f"register {write.name!r} takes an integer, not {write.named!r}: its values have no names")
    if write.named not in names:
        raise OutOfRange(f"register {write.name!r} has no value {write.named!r}{_nearest(write.named, names)}")
    return RegWrite(write.name, names[write.named], write.mask)


def in_range(name: str, value: int, low: int, high: int) -> None:
    """Raise OutOfRange for a value that a register does not allow."""
    if not low <= value <= high:
        raise OutOfRange(f"register {name!r}: {value} ({value:#x}) is outside {low} to {high} ({low:#x} to {high:#x})")
