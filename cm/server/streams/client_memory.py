# SPDX-License-Identifier: Apache-2.0
"""Memory over the data socket: for masters in the PL, such as HLS kernels with `m_axi`, and for measuring (echoes).

It is allocated and freed in a thread beside the loop, within bounds for each process and in total, and goes when its
client hangs up.
"""

from __future__ import annotations

import mmap
import os
import socket
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import TypeVar

from cm.device import DeviceNotFound
from cm.device.data_plane import Plane, StreamSetup
from cm.errors import Busy, CmError, InvalidRequest
from cm.server.devices import DeviceMemory
from cm.server.settings.model import USUAL
from cm.server.sockets import Loop
from cm.server.streams.client_process import Peer
from cm.wire.plane_packets import ADDRESS, Descriptor, Geometry, Open, encode_geometry, encode_refused

_T = TypeVar("_T")


class MemoryThread:
    """Does one task after another. Its methods are for the loop's thread."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._thread = ThreadPoolExecutor(1, "cm-memory")

    def run(self, work: Callable[[], _T], then: Callable[[Future[_T]], object] = lambda _: None) -> None:
        """Queue `work`, and pass its outcome to `then` in the loop's thread."""
        future = self._thread.submit(work)
        future.add_done_callback(lambda done: self._loop.call_threadsafe(lambda: then(done)))

    def close(self) -> None:
        """Wait until all queued work is done."""
        self._thread.shutdown()


MEMORIES = 64  # allocations of one user: each takes a file descriptor, however small it is


class MemoryBudget:
    """Counts bytes by user. Used in the loop's thread only."""

    def __init__(self, what: str, each: int = USUAL.memory_each_bytes, most: int = USUAL.memory_bytes) -> None:
        """`what`: how messages call the memory; `each`, `most`: limits in bytes, of one user and in total."""
        self._what = what
        self._each, self._most = each, most
        self._open: dict[int, tuple[Peer, int]] = {}  # by client of the plane

    def renew(self, each: int, most: int) -> None:
        """Set other limits; memory already allocated stays."""
        self._each, self._most = each, most

    def check(self, peer: Peer, length: int) -> None:
        """Raise Busy if a user may not have another `length` bytes."""
        held = [size for who, size in self._open.values() if who.uid == peer.uid]
        used = sum(size for _, size in self._open.values())
        if used + length > self._most:
            most = [f"pid {peer.pid} ({peer.name}) has {size}" for peer, size in self.held().most_common(4)]
            taken = f"{used} bytes are taken ({', '.join(most) or 'by nobody'})"
            raise Busy(f"{self._what} is {self._most >> 20} MiB together; {taken}")
        if sum(held) + length > self._each:
            raise Busy(
                f"{self._what} is {self._each >> 20} MiB for one user (limits.memory_mib); "
                f"processes of user {peer.uid} have {sum(held)} bytes"
            )
        if len(held) >= MEMORIES:
            raise Busy(f"processes of user {peer.uid} have {MEMORIES} pieces of {self._what}: no user gets more")

    def took(self, client: int, peer: Peer, length: int) -> None:
        """Record that a client of the plane has `length` bytes."""
        self._open[client] = peer, length

    def gone(self, client: int) -> None:
        """Record that a client has gone; it may have held nothing."""
        self._open.pop(client, None)

    def held(self) -> Counter[Peer]:
        """Bytes of each process."""
        found: Counter[Peer] = Counter()
        for peer, size in self._open.values():
            found[peer] += size
        return found


Take = Callable[[int], DeviceMemory]


class Allocations:
    """The memory that clients of the data socket hold, by their number in the plane. Used in the loop's thread."""

    def __init__(self, plane: Plane, thread: MemoryThread, take_of_port: Take, take: Take) -> None:
        """`take` allocates memory from any source; `take_of_port` from a configuration port, in another thread too."""
        self._plane = plane
        self._thread = thread
        self._take_of_port = take_of_port
        self._take = take
        self.budget = MemoryBudget("memory for masters in the PL")
        self._coming: dict[int, socket.socket] = {}  # clients whose memory is being allocated
        self._open: dict[int, tuple[int, DeviceMemory]] = {}  # client → stream, memory

    def open(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        """Begin to allocate memory for a process's connection. Raises InvalidRequest, Busy."""
        if wanted.length <= 0:
            raise InvalidRequest("memory has at least one byte")
        self.budget.check(peer, wanted.length)
        client = self._plane.adopt(os.dup(connection.fileno()))
        self.budget.took(client, peer, wanted.length)
        self._coming[client] = connection.dup()
        came = partial(self._came, client, wanted.length, peer)
        self._thread.run(partial(self._take_of_port, wanted.length), came)

    def _came(self, client: int, length: int, peer: Peer, taken: Future[DeviceMemory]) -> None:
        connection = self._coming.pop(client, None)
        if connection is None:  # it has gone
            if taken.exception() is None:
                self._thread.run(taken.result().free)
            return
        with connection:
            try:
                self._hand_over(client, self._taken(taken, length), length, peer)
            except (CmError, OSError) as error:
                self.budget.gone(client)
                self._plane.drop(client)
                with suppress(OSError):
                    code = error.code if isinstance(error, CmError) else "device_error"
                    connection.send(encode_refused(code, str(error)))

    def _taken(self, taken: Future[DeviceMemory], length: int) -> DeviceMemory:
        """Allocate elsewhere if the port gave none: from a channel only in this thread, which also opens streams."""
        try:
            return taken.result()
        except DeviceNotFound:
            return self._take(length)

    def _hand_over(self, client: int, memory: DeviceMemory, length: int, peer: Peer) -> None:
        try:
            stream = self._plane.start(None, StreamSetup(write=True, length=memory.length, address=memory.address))
            self._open[client] = (stream, memory)
            self._plane.add_slot(stream, memory.fd)
            self.budget.took(client, peer, memory.length)
            geometry = Geometry(
                memory.length,
                length,
                coherent=memory.coherent,
                writable=True,
                depth=1,
                shape=(length,),
                stream="memory",
            )
            self._plane.attach(client, stream, 1, encode_geometry(geometry))
            self._plane.tell(stream, Descriptor(kind=ADDRESS, length=length, sequence=memory.address).pack())
        except BaseException:
            self._free(client, memory)
            raise

    def _free(self, client: int, memory: DeviceMemory) -> None:
        stream, _ = self._open.pop(client, (0, memory))
        if stream:
            self._plane.stop(stream)
        self._thread.run(memory.free)

    def gone(self, client: int) -> None:
        """Release the memory of a client of the plane that has gone, if it had any."""
        coming = self._coming.pop(client, None)
        if coming is not None:
            coming.close()
        _, memory = self._open.get(client, (0, None))
        if memory is not None:
            self._free(client, memory)
        self.budget.gone(client)

    def close(self) -> None:
        """Close the connections that still wait for memory."""
        for connection in self._coming.values():
            connection.close()
        self._coming.clear()


_MAX_DEPTH = 16
_AT_ONCE = 8  # slots allocated in one step


class Echoes:
    """Each of its clients has its own memory, which is freed when the client hangs up."""

    def __init__(self, plane: Plane, thread: MemoryThread) -> None:
        self._plane = plane
        self._thread = thread
        self.budget = MemoryBudget("memory of echoes")
        self._open: dict[int, tuple[int, list[int]]] = {}  # client → stream, descriptors

    def open(self, connection: socket.socket, wanted: Open, peer: Peer) -> Iterator[None]:
        """Return the steps that give a process's connection its memory; the caller closes the connection.

        The steps raise InvalidRequest or Busy.
        """
        depth = min(wanted.depth or 2, _MAX_DEPTH)
        length = -(-wanted.length // mmap.PAGESIZE) * mmap.PAGESIZE
        if length <= 0:
            raise InvalidRequest("an echo needs a length of at least one byte")
        self.budget.check(peer, depth * length)
        client = self._plane.adopt(os.dup(connection.fileno()))
        self.budget.took(client, peer, depth * length)
        try:
            stream = self._plane.start(None, StreamSetup(write=True, length=length))
            self._open[client] = (stream, [])
            for made in range(1, depth + 1):
                self._add_slot(client, length)
                if made % _AT_ONCE == 0 and made < depth:
                    yield
                    if client not in self._open:  # it has gone
                        return
            geometry = Geometry(
                length, wanted.length, writable=True, depth=depth, shape=(wanted.length,), stream="echo"
            )
            self._plane.attach(client, stream, depth, encode_geometry(geometry))
        except BaseException:
            self.gone(client)
            self._plane.drop(client)
            raise

    def _add_slot(self, client: int, length: int) -> None:
        stream, fds = self._open[client]
        fds.append(os.memfd_create("cm-echo", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING))
        os.ftruncate(fds[-1], length)
        self._plane.add_slot(stream, fds[-1])

    def gone(self, client: int) -> None:
        """Release the memory of a client of the plane that has gone, if it had any."""
        self.budget.gone(client)
        stream, fds = self._open.pop(client, (0, []))
        if stream:
            self._plane.stop(stream)
            for fd in fds:  # its memory is freed if the client has unmapped it
                self._thread.run(partial(os.close, fd))
