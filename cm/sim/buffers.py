# SPDX-License-Identifier: Apache-2.0
"""DMA buffers of a simulated device: memfds by handle, as ``cm_buffer.h`` describes them."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from . import protocol
from .errors import NodeError
from .session import Answer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:
    from .later import np


PAGE = mmap.PAGESIZE
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL


class Buffer:
    """Memory that a client shares with the board; unmapped when nothing refers to it any more."""

    __slots__ = ("allocated", "bytes", "inflight", "length", "writable")

    def __init__(self, fd: int, length: int, allocated: bool, writable: bool = True) -> None:
        protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
        mapping = mmap.mmap(fd, length, mmap.MAP_SHARED | mmap.MAP_POPULATE, protection)
        self.bytes: NDArray[np.uint8] = np.frombuffer(mapping, np.uint8)
        self.length = length
        self.allocated = allocated
        self.writable = writable
        self.inflight = 0


class Memory:
    """The memory that all devices of the board may allocate, like a CMA area."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.used = 0

    def take(self, length: int) -> None:
        """Account for an allocation (ENOMEM)."""
        if self.used + length > self.total:
            raise NodeError(errno.ENOMEM, f"the board's {self.total} bytes of DMA memory are used up")
        self.used += length

    def give(self, length: int) -> None:
        """Account for a release."""
        self.used -= length


class Buffers:
    """The handles of one open file."""

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self._table: dict[int, Buffer] = {}
        self._next = 1

    def __len__(self) -> int:
        return len(self._table)

    def __iter__(self) -> Iterator[tuple[int, Buffer]]:
        return iter(self._table.items())

    def get(self, handle: int) -> Buffer:
        """The buffer of a handle (ENOENT)."""
        try:
            return self._table[handle]
        except KeyError:
            raise NodeError(errno.ENOENT, f"no buffer has the handle {handle}") from None

    def allocate(self, payload: bytes) -> Answer:
        """Answer a cm_buffer_alloc; the memfd travels with the reply."""
        flags, length, handle, fd, coherent, reserved = protocol.unpack(protocol.BUFFER_ALLOC, payload)
        protocol.require_zero(flags, reserved)
        if length <= 0:
            raise NodeError(errno.EINVAL, "a buffer has at least one byte")
        length = -(-length // PAGE) * PAGE
        self._memory.take(length)
        try:
            fd = _memfd(length)
            buffer = Buffer(fd, length, allocated=True)
        except (OSError, ValueError, OverflowError) as error:
            self._memory.give(length)
            raise NodeError(errno.ENOMEM, str(error)) from error
        handle, coherent = self._add(buffer), 1
        reply = protocol.BUFFER_ALLOC.pack(len(payload), 0, length, handle, fd, coherent, 0)
        return Answer(fit(reply, payload), [fd])

    def import_fd(self, payload: bytes, fds: Sequence[int]) -> bytes:
        """Answer a cm_buffer_import of the descriptor that came with the request."""
        flags, _, _, _ = protocol.unpack(protocol.BUFFER_IMPORT, payload)
        protocol.require_zero(flags)
        if len(fds) != 1:
            raise NodeError(errno.EBADF, "exactly one descriptor must travel with the request")
        buffer = _map_foreign(fds[0])
        handle = self._add(buffer)
        return fit(protocol.BUFFER_IMPORT.pack(len(payload), 0, -1, handle, buffer.length), payload)

    def free(self, payload: bytes) -> bytes:
        """Answer a cm_buffer_free."""
        flags, handle, reserved = protocol.unpack(protocol.BUFFER_FREE, payload)
        protocol.require_zero(flags, reserved)
        if self.get(handle).inflight:
            raise NodeError(errno.EBUSY, "a transfer uses the buffer")
        self._release(self._table.pop(handle))
        return payload

    def close(self) -> None:
        """Give everything back; transfers that still run keep the memory until they end."""
        for buffer in self._table.values():
            self._release(buffer)
        self._table.clear()

    def _add(self, buffer: Buffer) -> int:
        handle = self._next
        self._next += 1
        self._table[handle] = buffer
        return handle

    def _release(self, buffer: Buffer) -> None:
        if buffer.allocated:
            self._memory.give(buffer.length)


def fit(reply: bytes, request: bytes) -> bytes:
    """A reply's structure in the length that the caller knows it with."""
    return reply[: len(request)].ljust(len(request), b"\0")


def _memfd(length: int) -> int:
    fd = os.memfd_create("cm-sim-buffer", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(fd, length)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, _SEALS)
    except OSError:
        os.close(fd)
        raise
    return fd


def _map_foreign(fd: int) -> Buffer:
    """Map a client's memfd. It must not shrink under us, so it gets the seal, or has it."""
    try:
        if not fcntl.fcntl(fd, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK:
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
        length = os.fstat(fd).st_size
        writable = fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDWR
        return Buffer(fd, length, allocated=False, writable=writable)
    except (OSError, ValueError) as error:
        raise NodeError(errno.EINVAL, f"not a memfd that can be sealed and mapped: {error}") from error
