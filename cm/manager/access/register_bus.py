# SPDX-License-Identifier: Apache-2.0
"""Registers by name: rights, ranges, fields, and the access itself."""

from __future__ import annotations

import difflib
import threading
import time
from collections.abc import Callable, Mapping

from cm.manager.errors import AccessDenied, OutOfRange, UnknownRegister, VerifyFailed
from cm.manager.ports import Devices, Window
from cm.messages.requests import RegWrite
from cm.schema.model import Access, BitField, Decoupler, IsolationStep, Memory, Register

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


# ---- decouplers: what cuts a region off from the static part -----------------------------

_BETWEEN = 0.001  # seconds between two looks at a register that is waited for


def drive(registers: RegisterBus, decoupler: Decoupler, cut: bool) -> None:
    """Cut a region off, or connect it: a region believed cut off must be, so what is written is read back.

    Raises VerifyFailed, DeviceError; of a sequence some steps may have been taken then.
    """
    address = decoupler.base_address + decoupler.offset
    for step in decoupler.sequence or (_of_bit(decoupler),):
        value = step.cut if cut else step.couple
        mask = (1 << decoupler.width) - 1 if step.mask is None else step.mask
        if step.poll:
            _await(registers, address + step.offset, decoupler.width, (value & mask, mask, step.timeout))
        else:
            _set(registers, address + step.offset, decoupler.width, (value & mask, mask, step.verify))


def is_cut(registers: RegisterBus, decoupler: Decoupler) -> bool:
    """Whether the region is cut off now; False where its registers cannot be read back. Raises DeviceError."""
    address, all_bits = decoupler.base_address + decoupler.offset, (1 << decoupler.width) - 1
    told = [step for step in decoupler.sequence or (_of_bit(decoupler),) if step.verify or step.poll]
    for step in told:
        mask = all_bits if step.mask is None else step.mask
        if (registers.read_address(address + step.offset, decoupler.width) ^ step.cut) & mask:
            return False
    return bool(told)


def _of_bit(decoupler: Decoupler) -> IsolationStep:
    bit = 1 << decoupler.bit
    cut, couple = (bit, 0) if decoupler.active_high else (0, bit)
    return IsolationStep(0, cut, couple, mask=bit)


def _set(registers: RegisterBus, address: int, width: int, wanted: tuple[int, int, bool]) -> None:
    value, mask, verify = wanted
    whole = mask == (1 << width) - 1
    written = value if whole else registers.read_address(address, width) & ~mask | value
    registers.write_address(address, width, written)
    after = registers.read_address(address, width) if verify else written
    if (after ^ written) & mask:
        raise VerifyFailed(f"the decoupler at {address:#x} reads {after:#x} after {written:#x} (bits {mask:#x})")


def _await(registers: RegisterBus, address: int, width: int, wanted: tuple[int, int, float]) -> None:
    value, mask, timeout = wanted
    until = time.monotonic() + timeout
    while ((there := registers.read_address(address, width)) ^ value) & mask:
        if time.monotonic() >= until:
            raise VerifyFailed(
                f"the decoupler at {address:#x} reads {there:#x} after {timeout:g} s, not {value:#x} (bits {mask:#x})"
            )
        time.sleep(_BETWEEN)
