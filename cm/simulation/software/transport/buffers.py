# SPDX-License-Identifier: Apache-2.0
"""DMA buffers of a simulated device: memfds by handle, as ``cm_buffer.h`` describes them."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence

from cm.simulation.software.errors import NodeError, SimError
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.session import Answer, Ioctls
from cm.wire.lazy_numpy import NDArray, np

NAME = "cm-sim-noncoherent"  # of the memfds
_MAGIC = 0x434D53594E430001
_COUNTERS = struct.Struct("<QqQQQQQ")  # magic, holders, starts to read, to write, ends of both, ends without a start
_KEYS = ("read_starts", "write_starts", "read_ends", "write_ends", "unpaired")


class Counters:
    """What was done to one buffer of memory that is not coherent.

    Its memfd holds the processor's view, then the device's, then a page of these counts. What stands for
    ``DMA_BUF_IOCTL_SYNC`` (``csrc/tests/sim_dma_buf.c``) copies between the views and counts: so code that forgets a
    call reads or sends old bytes.
    """

    def __init__(self, fd: int, length: int) -> None:
        """`length` is that of one view."""
        self._page = mmap.mmap(fd, mmap.PAGESIZE, mmap.MAP_SHARED, offset=2 * length)
        _COUNTERS.pack_into(self._page, 0, _MAGIC, *(0,) * 6)

    @property
    def holders(self) -> int:
        """Starts without an end so far."""
        return int(_COUNTERS.unpack_from(self._page)[1])

    def counts(self) -> tuple[int, ...]:
        """In the order of `_KEYS`."""
        return tuple(_COUNTERS.unpack_from(self._page)[2:])


class Syncs:
    """The counters of all buffers that a node ever had."""

    def __init__(self) -> None:
        self._live: list[Counters] = []
        self._before = (0,) * len(_KEYS)
        self.early = 0  # transfers into or out of a buffer that the processor was still using

    def add(self, counters: Counters) -> None:
        """A new buffer."""
        self._live.append(counters)

    def submitted(self, counters: Counters) -> None:
        """The device is given a buffer."""
        self.early += counters.holders > 0

    def forget(self, counters: Counters) -> None:
        """A buffer is given back: from here on only those that still hold it are counted."""
        if counters.holders <= 0:
            self._live.remove(counters)
            self._before = _sum(self._before, counters.counts())

    def totals(self) -> dict[str, int]:
        """What was counted, by name."""
        totals = self._before
        for counters in self._live:
            totals = _sum(totals, counters.counts())
        held = sum(max(0, counters.holders) for counters in self._live)
        return {**dict(zip(_KEYS, totals, strict=True)), "held": held, "early": self.early}


def _sum(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(a + b for a, b in zip(one, other, strict=True))


PAGE = mmap.PAGESIZE
BASE = 0x1000_0000  # of the memory that is allocated, for masters in the PL
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW  # the manager may add others for its clients
_F_SEAL_FUTURE_WRITE = 0x0010  # linux/fcntl.h; the module has it from Python 3.13 on


class Buffer:
    """Memory that a client shares with the board; unmapped when nothing refers to it any more."""

    __slots__ = ("_array", "_mapping", "address", "allocated", "counters", "inflight", "length", "writable")

    def __init__(
        self, fd: int, length: int, allocated: bool, writable: bool = True, counters: Counters | None = None
    ) -> None:
        """With `counters` the device's view follows the processor's."""
        protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
        flags, offset = mmap.MAP_SHARED | mmap.MAP_POPULATE, length if counters else 0
        self._mapping = mmap.mmap(fd, length, flags, protection, offset=offset)
        self._array: NDArray[np.uint8] | None = None
        self.length = length
        self.address = 0  # the address that devices see, for memory that was allocated here
        self.allocated = allocated
        self.writable = writable
        self.inflight = 0
        self.counters = counters

    @property
    def memory(self) -> memoryview:
        """The content, without numpy, which is not imported before the board moves its first frame."""
        return memoryview(self._mapping)

    @property
    def bytes(self) -> NDArray[np.uint8]:
        """The content as an array."""
        if self._array is None:
            self._array = np.frombuffer(self._mapping, np.uint8)
        return self._array


class DmaMemory:
    """The memory that all devices of the board may allocate, like a CMA area: at addresses from `BASE` on."""

    def __init__(self, total: int, coherent: bool = True) -> None:
        self.total = total
        self.coherent = coherent
        self.used = 0
        self._placed: list[Buffer] = []  # in the order of their addresses

    def place(self, buffer: Buffer) -> None:
        """Give a buffer the first address where it has room."""
        buffer.address, index = BASE, 0
        for index, other in enumerate(self._placed):  # noqa: B007 - where it ended
            if buffer.address + buffer.length <= other.address:
                break
            buffer.address = other.address + other.length
        else:
            index = len(self._placed)
        self._placed.insert(index, buffer)

    def view(self, address: int, length: int) -> NDArray[np.uint8]:
        """The bytes at an address, as a master in the PL has them: writable, and no copy.

        Raises:
            SimError: no buffer has all of them.
        """
        buffer, offset = self.at(address, length)
        return buffer.bytes[offset : offset + length]

    def at(self, address: int, length: int) -> tuple[Buffer, int]:
        """The buffer that has these bytes, and where in it they begin. Raises SimError as `view`."""
        for buffer in self._placed:
            offset = address - buffer.address
            if offset >= 0 and offset + length <= buffer.length:
                return buffer, offset
        raise SimError(f"no memory was allocated for {length} bytes at {address:#x}")

    def take(self, length: int) -> None:
        """Account for an allocation (ENOMEM)."""
        if self.used + length > self.total:
            raise NodeError(errno.ENOMEM, f"the board's {self.total} bytes of DMA memory are used up")
        self.used += length

    def give(self, length: int, buffer: Buffer | None = None) -> None:
        """Account for a release."""
        self.used -= length
        if buffer is not None:
            self._placed.remove(buffer)


class Buffers:
    """The handles of one open file."""

    def __init__(self, memory: DmaMemory, syncs: Syncs) -> None:
        self._memory = memory
        self.syncs = syncs
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
        flags, length, handle, fd, coherent, reserved, _ = protocol.unpack(protocol.BUFFER_ALLOC, payload)
        protocol.require_zero(flags, reserved)
        if length <= 0:
            raise NodeError(errno.EINVAL, "a buffer has at least one byte")
        length = -(-length // PAGE) * PAGE
        self._memory.take(length)
        try:
            fd, buffer = self._make(length)
        except (OSError, ValueError, OverflowError) as error:
            self._memory.give(length)
            raise NodeError(errno.ENOMEM, str(error)) from error
        self._memory.place(buffer)
        handle, coherent = self._add(buffer), int(buffer.counters is None)
        reply = protocol.BUFFER_ALLOC.pack(len(payload), 0, length, handle, fd, coherent, 0, buffer.address)
        return Answer(fit(reply, payload), [fd])

    def _make(self, length: int) -> tuple[int, Buffer]:
        if self._memory.coherent:
            fd = _memfd("cm-sim-buffer", length)
            return fd, Buffer(fd, length, allocated=True)
        fd = _memfd(NAME, 2 * length + PAGE)
        counters = Counters(fd, length)
        self.syncs.add(counters)
        return fd, Buffer(fd, length, allocated=True, counters=counters)

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
            self._memory.give(buffer.length, buffer)
        if buffer.counters is not None:
            self.syncs.forget(buffer.counters)


class BufferSession(Ioctls):
    """An open file that has buffers; `first`: its module's first ioctl, which those of ``cm_buffer.h`` follow."""

    def __init__(self, buffers: Buffers, first: int, handlers: Mapping[int, Callable[[bytes], bytes | Answer]]) -> None:
        self.buffers = buffers
        super().__init__({**handlers, first + 1: buffers.allocate, first + 2: self._import, first + 3: buffers.free})

    def _import(self, payload: bytes) -> bytes:
        return self.buffers.import_fd(payload, self.fds)


def fit(reply: bytes, request: bytes) -> bytes:
    """A reply's structure in the length that the caller knows it with."""
    return reply[: len(request)].ljust(len(request), b"\0")


def _memfd(name: str, length: int) -> int:
    fd = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(fd, length)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, _SEALS)
    except OSError:
        os.close(fd)
        raise
    return fd


def _map_foreign(fd: int) -> Buffer:
    """Map a client's memfd. It must not shrink while we use it, so it is sealed, unless it is already."""
    try:
        seals = fcntl.fcntl(fd, fcntl.F_GET_SEALS)
        if not seals & fcntl.F_SEAL_SHRINK:
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
        length = os.fstat(fd).st_size
        writable = fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDWR
        writable = writable and not seals & (fcntl.F_SEAL_WRITE | _F_SEAL_FUTURE_WRITE)
        return Buffer(fd, length, allocated=False, writable=writable)
    except (OSError, ValueError) as error:
        raise NodeError(errno.EINVAL, f"not a memfd that can be sealed and mapped: {error}") from error
