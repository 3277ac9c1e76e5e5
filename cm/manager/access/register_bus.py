# SPDX-License-Identifier: Apache-2.0
"""Access to the hardware's registers and lines, and the isolation of regions by them: bits, sequences, GPIO lines."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from cm.field_access import Rest
from cm.manager.access.register_view import Place, in_range
from cm.manager.errors import AccessDenied, VerifyFailed
from cm.manager.inputs import Window
from cm.schema.model import Access, Decoupler, GpioLine, IsolationStep, Memory, Register

if TYPE_CHECKING:
    from cm.manager.interfaces import Devices, RegisterTable

_WO = Access.WO
_BETWEEN = 0.001  # seconds between two reads of a register that is waited for


class RegisterBus:
    """Reads and writes registers of the board; its lock keeps handles from being closed under an access."""

    def __init__(self, devices: Devices) -> None:
        self._devices = devices
        self._lock = threading.Lock()
        self._windows: dict[tuple[int, int], Window] = {}  # by address and width, until devices are closed
        self.closing: Callable[[], None] = lambda: None  # devices are about to be closed

    def forget(self, lost: bool = False) -> None:
        """Close register windows that have gone; with `lost` all devices."""
        with self._lock:
            self.closing()
            if lost:
                self._devices.lost()
                self._windows.clear()
            elif self._devices.forget():
                self._windows = {where: window for where, window in self._windows.items() if window.device.present}

    def read(self, register: Register) -> int:
        """The register's value. Raises AccessDenied for a write-only one, DeviceError."""
        if register.access is _WO:
            raise AccessDenied(f"register {register.name!r} is write-only")
        return self.read_address(register.address, register.width)

    def read_address(self, address: int, width: int) -> int:
        """The value at a physical address. Raises DeviceError."""
        with self._lock:
            window = self._windows.get((address, width)) or self._find(address, width)
            return window.device.read(window.offset, width, window.map)

    def read_places(self, places: Sequence[Place]) -> list[int]:
        """The values of registers, in this order. Raises DeviceError."""
        found, windows = [], self._windows
        with self._lock:
            for place in places:
                address, width = place.address, place.width
                window = windows.get((address, width)) or self._find(address, width)
                found.append(window.device.read(window.offset, width, window.map))
        return found

    def offer(self, name: str, place: Place, table: RegisterTable) -> None:
        """Let clients on this machine read a register or field by themselves. Raises DeviceError."""
        with self._lock:
            window = self._window(place.address, place.width)
            bits = (place.lsb, place.mask) if place.field else (0, (1 << 64) - 1)
            table.offer(name, window.device, (window.map, window.offset, place.width), bits)

    def write_address(self, address: int, width: int, value: int) -> None:
        """Write to a physical address. Raises DeviceError."""
        with self._lock:
            window = self._windows.get((address, width)) or self._find(address, width)
            window.device.write(window.offset, value, width, window.map)

    def _find(self, address: int, width: int) -> Window:
        """A window that is not kept yet."""
        window = self._windows[address, width] = self._devices.window(address, width)
        return window

    def _window(self, address: int, width: int) -> Window:
        return self._windows.get((address, width)) or self._find(address, width)

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
            return self._window(address, 8 * length)

    def read_block(self, memory: Memory, offset: int, length: int) -> bytearray:
        """Bytes of a memory, by accesses of 32 bits. Raises DeviceError."""
        with self._lock:
            window = self._window(memory.address, 8 * memory.size)
            return window.device.read_block(window.offset + offset, length, window.map)

    def write_block(self, memory: Memory, offset: int, data: memoryview) -> None:
        """Write bytes to a memory, by accesses of 32 bits. Raises DeviceError, part may be written then."""
        with self._lock:
            window = self._window(memory.address, 8 * memory.size)
            window.device.write_block(window.offset + offset, data, window.map)

    def take_flags(self, register: Register, clear: int, flags: int) -> int:
        """Read a status register and write 1 to those bits of `clear` that stand; returns what was read.

        `flags` are all its bits that a 1 clears: in a register whose other bits keep what is written, they are
        written as read, and flags that came meanwhile, or are another's, as 0, which leaves them. Raises DeviceError.
        """
        value = self.read(register)
        standing = value & clear
        if standing:
            rest = register.rest(clear | flags)
            kept = value & (rest.read | rest.last) | rest.ones
            self.write_address(register.address, register.width, kept | standing)
        return value

    def write(self, register: Register, value: int, mask: int, last: int | None, rest: Rest | None = None) -> int:
        """Write the bits in `mask`; returns the whole value written.

        `rest` (None: as the register says) is written to the others: they are read if they have to be, and `last` is
        what was last written to them.
        """
        full, rest = (1 << register.width) - 1, rest or register.rest(mask)
        value |= rest.ones | (last or 0) & rest.last
        if rest.read:
            value |= self.read_address(register.address, register.width) & rest.read
        in_range(register.name, value, register.minimum or 0, full if register.maximum is None else register.maximum)
        self.write_address(register.address, register.width, value)
        return value


def drive(registers: RegisterBus, decoupler: Decoupler, cut: bool) -> None:
    """Cut a region off, or connect it: a region believed cut off must be, so what is written is read back.

    Raises VerifyFailed, DeviceError; of a sequence some steps may have been taken then.
    """
    if decoupler.gpio is not None:
        _drive_line(registers, decoupler.gpio, int(cut == decoupler.active_high))
        return
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
    if decoupler.gpio is not None:
        return registers.read_line(decoupler.gpio) == int(decoupler.active_high)
    address, all_bits = decoupler.base_address + decoupler.offset, (1 << decoupler.width) - 1
    told = [step for step in decoupler.sequence or (_of_bit(decoupler),) if step.verify or step.poll]
    for step in told:
        mask = all_bits if step.mask is None else step.mask
        if (registers.read_address(address + step.offset, decoupler.width) ^ step.cut) & mask:
            return False
    return bool(told)


def _drive_line(registers: RegisterBus, line: GpioLine, value: int) -> None:
    registers.drive_line(line, value)
    after = registers.read_line(line)
    if after != value:
        raise VerifyFailed(f"the decoupler, line {line.line} of {line.chip}, reads {after} after {value}")


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
