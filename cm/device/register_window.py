# SPDX-License-Identifier: Apache-2.0
"""Register pages on loan: lent by who has the board, mapped by whom they were given to, taken back at once.

``docs/decisions/revocable-mappings.md`` says why. Needs the kernel module ``cm_window``, or a simulated board.
"""

from __future__ import annotations

import contextlib
import enum
import os
from types import TracebackType
from typing import Any, ClassVar, NoReturn

from cm.device import advice
from cm.device.base import AnyRoot, Device, Shim, out_of_range
from cm.device.errors import DeviceRevoked, device_error
from cm.device.native import window as native
from cm.device.native.call import Handle, last_error
from cm.device.paths import Root
from cm.frozen import dataclass


class WindowEnd(enum.IntEnum):
    """What became of a grant."""

    RELEASED = native.RELEASED  # its last descriptor and mapping are gone
    CALL = native.REVOKED_CALL  # it was revoked by a call
    BRIDGE = native.REVOKED_BRIDGE  # its region is decoupled
    OWNER = native.REVOKED_OWNER  # who lent it is gone
    GONE = native.REVOKED_GONE  # its device is gone
    SLEEP = native.REVOKED_SLEEP  # the system was suspended


@dataclass(frozen=True, slots=True)
class WindowEvent:
    """A grant that ended: by the kernel, or since nobody has it any more."""

    id: int
    reason: WindowEnd


@dataclass(frozen=True, slots=True)
class Grant:
    """Pages on loan: ``fd`` is to be given away (SCM_RIGHTS), and closed here."""

    id: int
    fd: int

    def close(self) -> None:
        """Close this process's descriptor; who got one keeps the pages. Once."""
        os.close(self.fd)

    def __enter__(self) -> Grant:
        return self

    def __exit__(self, kind: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


class Windows(Device):
    """The node that lends: ``/dev/cm_window``. What it has lent ends when it is closed."""

    _shim: ClassVar[Shim] = native

    @classmethod
    def open(cls, root: AnyRoot = None) -> Windows:
        """Open the node. Raises DeviceNotFound where the kernel module is not loaded, DevicePermission."""
        base = Root.of(root)
        path = base.join("dev/cm_window")
        try:
            return cls(native.open_node(base.prefix), path)
        except OSError as error:
            hint = "modprobe cm_window" if isinstance(error, FileNotFoundError) else advice.permission(path)
            raise device_error(error, "open", str(path), hint) from error

    def grant(self, address: int, length: int, write: bool = False) -> Grant:
        """Lend ``length`` bytes at a physical address, whole pages of one window.

        Raises DeviceGone where no window has them, DeviceInvalid where they or the window are no whole pages,
        DevicePermission where others have registers in the window's pages, DeviceError (EAGAIN) while its region is
        decoupled, (ENOSPC) for more than 4096 grants at a time.
        """
        doing = f"lend 0x{address:x}+0x{length:x} by"
        try:
            return Grant(*native.grant(self._handle, address, length, native.WRITE if write else 0))
        except (OSError, OverflowError) as error:
            raise self._error(error, doing) from error

    def revoke(self, address: int, length: int) -> int:
        """Take back whatever of a range was lent, from whomever; returns from how many.

        When it returns no process reaches the range by a grant any more.
        """
        try:
            return native.revoke(self._handle, address, length)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"take 0x{address:x}+0x{length:x} back by") from error

    def revoke_grant(self, number: int) -> bool:
        """Take one grant back; False where it had been. Raises DeviceNotFound where it is released, and was told."""
        try:
            return bool(native.revoke_one(self._handle, number))
        except (OSError, OverflowError) as error:
            raise self._error(error, f"take grant {number} back by") from error

    def take(self) -> list[WindowEvent]:
        """The events since the last call: grants that were released, or revoked by the kernel. Never blocks."""
        found = []
        try:
            while events := native.take(self._handle):
                found += [WindowEvent(event.id, WindowEnd(event.reason)) for event in events]
                if len(events) < native.TAKE_AT_ONCE:
                    break
        except OSError as error:
            raise self._error(error, "read") from error
        return found


class MappedWindow:
    """Pages that were lent to this process. Offsets are bytes, values unsigned.

    Threads may share one, and one may close it: the others' calls raise DeviceClosed then.
    """

    def __init__(self, fd: int) -> None:
        """Map what a descriptor stands for, which stays the caller's; on a simulated board it can be done once.

        Raises DeviceInvalid, DeviceGone for a descriptor of something else.
        """
        try:
            self._handle: Handle = native.map_grant(fd)
        except (OSError, OverflowError) as error:
            if isinstance(error, OverflowError):
                raise out_of_range("map", "a window's descriptor") from error
            raise device_error(error, "map", "a window's descriptor") from error
        self.size, self.writable = native.shape(self._handle)

    def read(self, offset: int, width: int = 32) -> int:
        """Read the register of ``width`` bits (8, 16, 32, 64) at ``offset``: one bus access.

        Raises DeviceRevoked once the pages were taken back, DeviceInvalid for what is not there.
        """
        try:
            if width > 32:
                return native.read(self._handle, offset, width)
            found: int = native.read32(self._handle, offset, width)
            if found < 0:
                raise last_error()
            return found
        except (OSError, OverflowError) as error:
            self._raise(error, f"read 0x{offset:x} of")

    def write(self, offset: int, value: int, width: int = 32) -> None:
        """Write a register: one bus access. DeviceRevoked: it may not have reached it; DevicePermission: read only."""
        try:
            native.write(self._handle, offset, width, value)
        except (OSError, OverflowError) as error:
            self._raise(error, f"write 0x{offset:x} of")

    def read_block(self, offset: int, length: int) -> bytearray:
        """Several words, each one access of 32 bits."""
        data = bytearray(length)
        try:
            native.read_block(self._handle, offset, data)
        except (OSError, OverflowError) as error:
            self._raise(error, f"read 0x{offset:x} of")
        return data

    def write_block(self, offset: int, data: Any) -> None:
        """Write several words, each one access of 32 bits."""
        try:
            native.write_block(self._handle, offset, data)
        except (OSError, OverflowError) as error:
            self._raise(error, f"write 0x{offset:x} of")

    @property
    def shim_handle(self) -> Any:
        """For calls of `cm.device.native.window`: `read32` is several times faster than `read`."""
        return self._handle

    @property
    def revoked(self) -> WindowEnd | None:
        """Why the pages were taken back, or None. Raises DeviceClosed after `close`."""
        try:
            reason = native.revoked(self._handle)
        except OSError as error:
            self._raise(error, "look at")
        return WindowEnd(reason) if reason else None

    def close(self) -> None:
        """Give the pages back; twice is fine."""
        native.unmap(self._handle)

    def __enter__(self) -> MappedWindow:
        return self

    def __exit__(self, kind: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _raise(self, error: OSError | OverflowError, doing: str) -> NoReturn:
        if isinstance(error, OverflowError):
            raise out_of_range(doing, "a window") from error
        made = device_error(error, doing, "a window")
        if isinstance(made, DeviceRevoked):
            made.reason = WindowEnd.CALL
            with contextlib.suppress(OSError):
                made.reason = WindowEnd(native.revoked(self._handle))
        raise made from error
