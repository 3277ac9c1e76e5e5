# SPDX-License-Identifier: Apache-2.0
"""Registers by name: rights, ranges, fields, and the access itself."""

from __future__ import annotations

import difflib
import threading
from collections.abc import Callable, Mapping

from cm.manager.errors import AccessDenied, OutOfRange, UnknownRegister
from cm.manager.ports import Devices, Window
from cm.messages.requests import RegWrite
from cm.schema.model import Access, BitField, GpioLine, Memory, Register

_WO = Access.WO


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
        _in_range(write.name, write.value, 0, limit)
        return register, write.value << field.lsb, field.mask
    _in_range(write.name, write.value, 0, full)
    if write.mask is None:
        _in_range(
            write.name, write.value, register.minimum or 0, full if register.maximum is None else register.maximum
        )
        return register, write.value, full
    if not 0 <= write.mask <= full:
        raise OutOfRange(f"register {write.name!r}: mask {write.mask:#x} does not fit {register.width} bits")
    return register, write.value & write.mask, write.mask


def _by_name(write: RegWrite, field: BitField | None) -> RegWrite:
    """A write of a value that was named, with the value. Raises OutOfRange."""
    names = field.values if field is not None else {}
    if not names:
        raise OutOfRange(f"register {write.name!r} takes an integer, not {write.named!r}: its values have no names")
    if write.named not in names:
        raise OutOfRange(f"register {write.name!r} has no value {write.named!r}{_nearest(write.named, names)}")
    return RegWrite(write.name, names[write.named], write.mask)


def _in_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise OutOfRange(f"register {name!r}: {value} ({value:#x}) is outside {low} to {high} ({low:#x} to {high:#x})")


class RegisterBus:
    """Reads and writes registers of the board; its lock keeps handles from being closed under an access."""

    def __init__(self, devices: Devices) -> None:
        self._devices = devices
        self._lock = threading.Lock()

    def forget(self, lost: bool = False) -> None:
        """Close register windows, which may have come or gone; with `lost` all devices."""
        with self._lock:
            if lost:
                self._devices.lost()
            else:
                self._devices.forget()

    def read(self, register: Register) -> int:
        """The register's value. Raises AccessDenied for a write-only one, DeviceError."""
        if register.access is _WO:
            raise AccessDenied(f"register {register.name!r} is write-only")
        return self.read_address(register.address, register.width)

    def read_address(self, address: int, width: int) -> int:
        """The value at a physical address. Raises DeviceError."""
        with self._lock:
            window = self._devices.window(address, width)
            return window.device.read(window.offset, width, window.map)

    def write_address(self, address: int, width: int, value: int) -> None:
        """Write to a physical address. Raises DeviceError."""
        with self._lock:
            window = self._devices.window(address, width)
            window.device.write(window.offset, value, width, window.map)

    def read_line(self, line: GpioLine) -> int:
        """0 or 1. Raises DeviceError."""
        with self._lock:
            return self._devices.gpio(line.chip, line.line).value

    def drive_line(self, line: GpioLine, value: int) -> None:
        """Make a line an output with this value. Raises DeviceError."""
        with self._lock:
            self._devices.gpio(line.chip, line.line).value = value

    def place(self, address: int, length: int) -> Window:
        """The window that has `length` bytes at a physical address. Raises DeviceNotFound."""
        with self._lock:
            return self._devices.window(address, 8 * length)

    def read_block(self, memory: Memory, offset: int, length: int) -> bytearray:
        """Bytes of a memory, by accesses of 32 bits. Raises DeviceError."""
        with self._lock:
            window = self._devices.window(memory.address, 8 * memory.size)
            return window.device.read_block(window.offset + offset, length, window.map)

    def write_block(self, memory: Memory, offset: int, data: memoryview) -> None:
        """Write bytes to a memory, by accesses of 32 bits. Raises DeviceError, part may be written then."""
        with self._lock:
            window = self._devices.window(memory.address, 8 * memory.size)
            window.device.write_block(window.offset + offset, data, window.map)

    def take_flags(self, register: Register, clear: int, flags: int) -> int:
        """Read a status register and write 1 to those bits of `clear` that stand; returns what was read.

        `flags` are all its bits that a 1 clears: in a register whose other bits keep what is written, they are
        written as read, and flags that came meanwhile, or are another's, as 0, which leaves them. Raises DeviceError.
        """
        value = self.read(register)
        standing = value & clear
        if standing:
            kept = 0 if register.access is Access.W1C else value & ~flags
            self.write_address(register.address, register.width, kept | standing)
        return value

    def write(self, register: Register, value: int, mask: int, last: int | None) -> int:
        """Write the bits in `mask`; returns the whole value written.

        The other bits are read first; of a write-only register they are those last written, and a
        write-one-to-clear register's are written as 0, which clears nothing.
        """
        full = (1 << register.width) - 1
        if mask != full:
            value = self._merged(register, value, mask, last)
            _in_range(
                register.name, value, register.minimum or 0, full if register.maximum is None else register.maximum
            )
        self.write_address(register.address, register.width, value)
        return value

    def _merged(self, register: Register, value: int, mask: int, last: int | None) -> int:
        if register.access is Access.W1C:
            return value
        rest = (last or 0) if register.access is Access.WO else self.read_address(register.address, register.width)
        return (rest & ~mask) | value
