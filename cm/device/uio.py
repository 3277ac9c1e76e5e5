# SPDX-License-Identifier: Apache-2.0
"""Registers and interrupts of UIO devices."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any, ClassVar

from cm.device import advice
from cm.device.base import AnyRoot, Device, Shim
from cm.device.errors import DeviceError, DeviceInvalid, DeviceNotFound, device_error
from cm.device.native import uio as native
from cm.device.native.call import Handle, last_error
from cm.device.native.uio import UioInfo as UioInfo
from cm.device.native.uio import UioMap as UioMap
from cm.device.paths import Root, Standing

WIDTHS = (8, 16, 32, 64)


def list_uio(root: AnyRoot = None) -> list[UioInfo]:
    """Return all UIO devices by number; none where the system has no such class."""
    base = Root.of(root)
    found = []
    try:
        for number in native.numbers(base.prefix):
            try:
                found.append(native.describe(base.prefix, number))
            except FileNotFoundError:
                continue  # it went away after it was listed
    except OSError as error:
        raise device_error(error, "list", str(base.join("sys/class/uio"))) from error
    return found


def find_uio(address: int, length: int = 1, root: AnyRoot = None) -> tuple[UioInfo, int]:
    """Return the device, and the index of its map, that cover ``length`` bytes at ``address``.

    Raises DeviceNotFound, which lists the windows there are.
    """
    base = Root.of(root)
    try:
        return native.find_address(base.prefix, address, length)
    except (OSError, OverflowError) as error:
        raise _no_window(base, address, length) from error


def _windows(infos: list[UioInfo]) -> str:
    return ", ".join(f"{i.node} {i.name} 0x{m.address:x}+0x{m.size:x}" for i in infos for m in i.maps)


def _no_window(root: Root, address: int, length: int) -> DeviceNotFound:
    path = str(root.join("sys/class/uio"))
    there = _windows(list_uio(root)) or "none"
    text = f"no UIO device covers 0x{address:x}+0x{length:x}; windows in {path}: {there}"
    return DeviceNotFound(errno.ENOENT, text, path)


def _find(root: Root, name: str | int) -> UioInfo:
    if isinstance(name, int):
        return find_uio(name, 1, root)[0]
    path = root.join("sys/class/uio")
    try:
        return native.find_name(root.prefix, name)
    except FileNotFoundError as error:
        present = [f"{info.node} ({info.name})" for info in list_uio(root)]
        hint = advice.missing(path / name, present)
        raise device_error(error, "find UIO device", f"{name!r} in {path}", hint) from error
    except (OSError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) and error.errno else errno.EINVAL
        raise device_error(number, "find UIO device", f"{name!r} in {path}") from error


class Uio(Device):
    """Registers and the interrupt of one UIO device.  Offsets are bytes, values unsigned."""

    _shim: ClassVar[Shim] = native

    def __init__(self, handle: Handle, path: Path, info: UioInfo, folder: Standing) -> None:
        """Take over an open handle; use `open`. `folder` is that of sysfs."""
        super().__init__(handle, path)
        self.info = info
        self._folder = folder

    @classmethod
    def open(cls, name: str | int, root: AnyRoot = None) -> Uio:
        """Open by the device's name, by "uioN", or by a physical address (int) that a map covers.

        Raises DeviceNotFound, DevicePermission, DeviceGone.
        """
        base = Root.of(root)
        info = _find(base, name)
        path = base.join("dev", info.node)
        folder = Standing(base.join("sys/class/uio", info.node))  # before it is opened: one that comes later is another
        try:
            handle = native.open_number(base.prefix, info.number)
        except OSError as error:
            nodes = [node for node in advice.names(base.join("dev")) if node.startswith("uio")]
            raise device_error(error, "open", str(path), advice.unopened(error, base, path, nodes)) from error
        return cls(handle, path, info, folder)

    @property
    def name(self) -> str:
        """The device's name, of the driver or the device tree."""
        return self.info.name

    @property
    def maps(self) -> tuple[UioMap, ...]:
        """The windows, by index."""
        return self.info.maps

    @property
    def present(self) -> bool:
        """Whether the device that was opened is still there: overlays take some, and numbers are used again."""
        return self._folder.stands

    @property
    def shim_handle(self) -> Any:
        """The handle that `cm.device.register_reads` passes to C; valid as long as this object."""
        return self._handle

    def read(self, offset: int, width: int = 32, map: int = 0) -> int:  # noqa: A002
        """Read the register of ``width`` bits (8, 16, 32, 64) at ``offset``: one bus access.

        Raises DeviceInvalid for an offset, width or map that is not there; the bus is not touched.
        """
        try:
            if width > 32:
                return native.read(self._handle, map, offset, width)
            found: int = native.read32(self._handle, map, offset, width)
            if found < 0:
                raise last_error()
            return found
        except (OSError, OverflowError) as error:
            raise self._access_error(error, "read", offset, width, map) from error

    def write(self, offset: int, value: int, width: int = 32, map: int = 0) -> None:  # noqa: A002
        """Write ``value`` to the register at ``offset``; as `read`, also DeviceInvalid if it is too wide."""
        try:
            if native.write(self._handle, map, offset, width, value) < 0:
                raise last_error()
        except (OSError, OverflowError) as error:
            raise self._access_error(error, f"write {value:#x} to", offset, width, map) from error

    def read_block(self, offset: int, length: int, map: int = 0) -> bytearray:  # noqa: A002
        """Read ``length`` bytes from ``offset`` on, both multiples of 4: one bus access of 32 bits for each word.

        The bytes are as they lie in the window, little-endian: ``numpy.frombuffer(data, "<u4")``.  A long block
        does not keep other threads from running.  Raises DeviceInvalid for what is not there, with nothing read.
        """
        try:
            return native.read_block(self._handle, map, offset, self._whole(length))
        except (OSError, OverflowError) as error:
            raise self._block_error(error, "read", offset, length, map) from error

    def write_block(self, offset: int, data: native.Buffer, map: int = 0) -> None:  # noqa: A002
        """Write ``data`` (contiguous) from ``offset`` on, as `read_block` reads.

        Raises DeviceInvalid for what is not there, with nothing written; another DeviceError may come after
        part was written.
        """
        view = memoryview(data).cast("B")
        try:
            native.write_block(self._handle, map, offset, view)
        except (OSError, OverflowError) as error:
            raise self._block_error(error, "write", offset, len(view), map) from error

    def enable_interrupt(self) -> None:
        """Let the next interrupt through; uio_pdrv_genirq masks it each time it comes."""
        try:
            native.enable_interrupt(self._handle)
        except OSError as error:
            raise self._interrupt_error(error, "enable the interrupt of") from error

    def take(self) -> int | None:
        """Return the count of interrupts so far (modulo 2^32) if one came since the last take; never blocks."""
        try:
            return native.take(self._handle)
        except OSError as error:
            raise self._interrupt_error(error, "take the interrupt of") from error

    def wait(self, timeout: float | None = None) -> int:
        """Wait up to ``timeout`` seconds for an interrupt and return the count; DeviceTimeout."""
        try:
            return native.wait_interrupt(self._handle, timeout)
        except OSError as error:
            raise self._interrupt_error(error, "wait for the interrupt of") from error

    def _interrupt_error(self, error: OSError, doing: str) -> DeviceError:
        """UIO answers EIO for a device without an interrupt, and EIO or EINVAL once its driver was unbound."""
        if error.errno in (errno.EIO, errno.EINVAL) and not self.present:
            return device_error(errno.ENODEV, doing, self.path, "its driver was unbound, as when its overlay goes")
        none = "the device has no interrupt: give its device-tree node one"
        return self._error(error, doing, none if error.errno == errno.EIO else "")

    def _whole(self, length: int) -> int:
        """`length`, after a check that a window is that long, before any memory is allocated for it."""
        if not 0 <= length <= max((m.size for m in self.maps), default=0):
            raise OverflowError
        return length

    def _block_error(self, error: Exception, doing: str, offset: int, length: int, index: int) -> DeviceError:
        if isinstance(error, OSError) and error.errno != errno.EINVAL:
            return self._error(error, f"{doing} {length} bytes at offset {offset:#x} of")
        text = f"cannot {doing} {length} bytes at offset {offset:#x} of map {index}: {self.name} has {self._sizes()}"
        rule = "offset and length are multiples of 4, since each access has 32 bits"
        return DeviceInvalid(errno.EINVAL, f"{text}; {rule}", self.path)

    def _sizes(self) -> str:
        return ", ".join(f"map {i}: 0x{m.size:x} bytes" for i, m in enumerate(self.maps)) or "no map"

    def _access_error(self, error: Exception, doing: str, offset: int, width: int, index: int) -> DeviceError:
        if isinstance(error, OSError) and error.errno not in (errno.EINVAL, errno.ERANGE):
            return self._error(error, f"{doing} offset {offset:#x} of")
        rule = f"widths are {', '.join(str(w) for w in WIDTHS)}, offsets multiples of them, values no wider"
        text = f"cannot {doing} offset {offset:#x} of map {index} with {width} bits: {self.name} has {self._sizes()}"
        return DeviceInvalid(errno.EINVAL, f"{text}; {rule}", self.path)
