# SPDX-License-Identifier: Apache-2.0
"""Registers that local clients read by name, without the manager: a table, and a C thread (csrc/reads.h)."""

from __future__ import annotations

import errno
import os

from cm.device.errors import DeviceBusy, device_error
from cm.device.native import reads as native
from cm.device.uio import Uio


class RegisterReads:
    """What clients may read, and their connections. Any thread; `close()` ends it, twice is fine."""

    def __init__(self) -> None:
        """Start the thread, with an empty table."""
        self._handle = native.new()
        self._kept: set[Uio] = set()  # what the table points to
        self._open = True

    def fileno(self) -> int:
        """Polls readable once a client asked for what the table lacks; then `take`."""
        return native.wanted_fd(self._handle)

    def take(self) -> None:
        """Note that the table lacks something; it is not told again before `withdraw`."""
        os.eventfd_read(native.wanted_fd(self._handle))

    def adopt(self, fd: int, pid: int) -> None:
        """Take over a process's connected socket. Raises DeviceBusy for one too many; `fd` is the caller's then."""
        try:
            native.adopt(self._handle, fd, pid)
        except OSError as error:
            if error.errno == errno.EUSERS:
                raise DeviceBusy(errno.EBUSY, "too many connections that read registers: close some") from error
            raise device_error(error, "read registers for", f"pid {pid}") from error

    def offer(self, name: str, uio: Uio, place: tuple[int, int, int], bits: tuple[int, int]) -> None:
        """Let clients read `name`: map, offset and width in a device, lowest bit and mask of the value.

        What is not read by a load is left out: a simulated node that sees each access. Raises DeviceError, also where
        a read hangs.
        """
        index, offset, width = place
        if not native.loads(uio.shim_handle, index):
            return
        self._kept.add(uio)
        try:
            native.offer(self._handle, name, native.Read(uio.shim_handle, index, width, offset, bits[1], bits[0]))
        except OSError as error:
            raise device_error(error, "offer", repr(name)) from error

    def withdraw(self) -> None:
        """Empty the table: no read is under way when it returns."""
        if self._open:
            native.withdraw(self._handle)
        self._kept.clear()

    def close(self) -> None:
        """End the thread, hang up on all."""
        if self._open:
            self._open = False
            native.close(self._handle)
