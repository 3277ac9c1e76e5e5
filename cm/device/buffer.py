# SPDX-License-Identifier: Apache-2.0
"""DMA buffers: memory that a device and the processor share."""

from __future__ import annotations

import errno
import os
import weakref
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any

from cm.device.errors import DeviceInvalid, device_error
from cm.device.native import buffer as native
from cm.device.native.call import Handle

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

# The device is gone or closed, has forgotten the handle, or does not answer: nothing can be given back.
_FREED_WITH_DEVICE = (errno.EBADF, errno.ENODEV, errno.ENOENT, errno.ETIMEDOUT)


class DmaBuffer:
    """A buffer of one device, made by its ``allocate()`` or ``import_buffer()``.

    ``fd`` is a dma-buf (a memfd on a simulated board) and may be passed to other processes; it is
    owned by this object.  ``handle`` is what the device knows the buffer by, ``address`` where it sees
    it (0: not told, as for an imported one).  Arrays and views keep
    the memory after ``close()``, and after the device was closed.
    """

    def __init__(self, handle: Handle, free: Callable[[int], None], path: str) -> None:
        """Take over a ``struct cm_buffer``; ``free`` gives its handle back to the device."""
        self._struct = handle
        self._free: Callable[[int], None] | None = free
        self._path = path
        self._mappings: dict[bool, Any] = {}
        self.fd, self.handle, self.coherent, self.length, self.address = native.fields(handle)
        # Not __del__: if buffer and device become garbage together, the device might be freed first. A weak
        # reference's callback runs before that, and keeps the device alive until it has run.
        # (mypy takes atexit, a property, for an attribute that __slots__ forbids.)
        self._forgotten = weakref.finalize(self, _give_back, free, self.handle, handle, os.getpid())
        self._forgotten.atexit = False  # type: ignore[misc]

    def memoryview(self, writable: bool = True) -> memoryview:
        """Return the whole buffer as bytes, mapped once and kept."""
        if writable not in self._mappings:
            try:
                self._mappings[writable] = native.map_memory(self._struct, writable)
            except OSError as error:
                raise device_error(error, "map a buffer of", self._path) from error
        view = memoryview(self._mappings[writable])
        return view if writable else view.toreadonly()

    def unmap(self) -> None:
        """Keep no mapping: what only its device uses is no memory of ours. Arrays and views keep theirs."""
        self._mappings.clear()

    def array(self, offset: int = 0, length: int | None = None, writable: bool = True) -> npt.NDArray[np.uint8]:
        """Return ``length`` bytes (default: the rest) from ``offset`` as a uint8 view, not a copy."""
        import numpy as np  # imported here, because a manager needs no arrays

        length = self.length - offset if length is None else length
        self.check_range(offset, length)
        return np.frombuffer(self.memoryview(writable), np.uint8, length, offset)

    def check_range(self, offset: int, length: int) -> None:
        """Raise DeviceInvalid unless the range lies in the buffer."""
        if offset < 0 or length < 0 or offset + length > self.length:
            text = f"range {offset}+{length} is not inside the buffer of {self.length} bytes"
            raise DeviceInvalid(errno.EINVAL, f"cannot use a buffer of {self._path}: {text}", self._path)

    def sync_begin(self, write: bool) -> None:
        """Announce that the CPU is about to read (and with ``write`` to write) the memory."""
        self._sync(True, write)

    def sync_end(self, write: bool) -> None:
        """Announce that the CPU is done, with the ``write`` of `sync_begin`."""
        self._sync(False, write)

    def close(self) -> None:
        """Give the handle back and close ``fd``; twice is fine.

        Raises DeviceBusy while a transfer uses the buffer, which then stays as it was.
        """
        if self._free is None:
            return
        try:
            self._free(self.handle)
        except OSError as error:
            if error.errno not in _FREED_WITH_DEVICE:
                raise device_error(
                    error, "free a buffer of", self._path, "cancel, or wait for, its transfer"
                ) from error
        self._free = None
        self._forgotten.detach()
        self._mappings.clear()
        native.close(self._struct)
        self.fd = -1

    def _sync(self, begin: bool, write: bool) -> None:
        if self._free is None:
            raise device_error(errno.EBADF, "synchronise a buffer of", self._path)
        try:
            native.sync(self._struct, begin, write)
        except OSError as error:
            raise device_error(error, "synchronise a buffer of", self._path) from error

    def __enter__(self) -> DmaBuffer:
        return self

    def __exit__(self, kind: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __len__(self) -> int:
        return self.length

    def __repr__(self) -> str:
        return f"<DmaBuffer {self.handle} of {self._path}, {self.length} bytes>"


def _give_back(free: Callable[[int], None], number: int, handle: Handle, owner: int) -> None:
    """Give back what was forgotten; a buffer in flight stays with its device until that is closed."""
    if os.getpid() != owner:  # a child after fork() must not free what its parent uses
        return
    with suppress(OSError):
        free(number)
    native.close(handle)
