# SPDX-License-Identifier: Apache-2.0
"""Memory over the data socket: for masters in the PL, such as HLS kernels with `m_axi`, and for measuring (echoes).

It is allocated and freed in a thread beside the loop, within bounds for each user and in total, and goes when its
client hangs up.
"""

from __future__ import annotations

import mmap
import os
import socket
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial

from cm.device import DeviceNotFound
from cm.device.data_plane import Plane, StreamSetup
from cm.errors import Busy, CmError, InvalidRequest
from cm.frozen import dataclass, field
from cm.server.client_process import Peer
from cm.server.devices import DeviceMemory
from cm.server.error_replies import encode_refusal
from cm.server.settings.model import Limits
from cm.server.sockets import Loop
from cm.wire.plane_packets import ADDRESS, Descriptor, Geometry, Open, Purpose, encode_geometry

MEMORIES = 64  # of one user: each takes file descriptors, however small it is
_MAX_DEPTH = 16  # slots of an echo
_Take = Callable[[int], DeviceMemory]


@dataclass(slots=True)
class _Held:
    """A client's memory: of so many bytes, and what it has of it by now."""

    peer: Peer
    bytes: int
    connection: socket.socket | None  # while it is being allocated
    slots: list[DeviceMemory] = field(default_factory=list)
    stream: int = 0  # in the plane


def check_share(peer: Peer, length: int, held: Sequence[tuple[Peer, int]], each: int, most: int) -> None:
    """Raise Busy if a user may not have another `length` bytes; `held`: the memories that there are, with their bytes.

    `each`, `most`: limits in bytes, of one user and in total.
    """
    own = [size for other, size in held if other.uid == peer.uid]
    used = sum(size for _, size in held)
    if used + length > most:
        sizes = Counter[Peer]()
        for other, size in held:
            sizes[other] += size
        named = [f"pid {other.pid} ({other.name}) has {size}" for other, size in sizes.most_common(4)]
        taken = f"{used} bytes are taken ({', '.join(named) or 'by nobody'})"
        raise Busy(f"memory for masters in the PL and echoes is {most >> 20} MiB together; {taken}")
    if sum(own) + length > each:
        raise Busy(
            f"memory for masters in the PL and echoes is {each >> 20} MiB for one user (limits.memory_mib); "
            f"processes of user {peer.uid} have {sum(own)} bytes"
        )
    if len(own) >= MEMORIES:
        raise Busy(f"processes of user {peer.uid} have {MEMORIES} pieces of memory: no user gets more")


class ClientMemories:
    """The memory that clients of the data socket hold, by their number in the plane. The loop's thread."""

    def __init__(self, loop: Loop, plane: Plane, take_of_port: _Take, take: _Take, limits: Limits) -> None:
        """`take` allocates memory from any source; `take_of_port` from a configuration port, in another thread too."""
        self._loop = loop
        self._plane = plane
        self._take_of_port, self._take = take_of_port, take
        self._thread = ThreadPoolExecutor(1, "cm-memory")
        self._held: dict[int, _Held] = {}
        self.limits = limits

    def held(self) -> list[tuple[Peer, int]]:
        """The memories that there are: whose, and of how many bytes."""
        return [(held.peer, held.bytes) for held in self._held.values()]

    def open(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        """Begin to allocate memory for a process's connection. Raises InvalidRequest, Busy."""
        echo = wanted.purpose is Purpose.ECHO
        if wanted.length <= 0:
            raise InvalidRequest(f"{'an echo' if echo else 'memory'} has at least one byte")
        depth, length = 1, wanted.length
        if echo:
            depth, length = min(wanted.depth or 2, _MAX_DEPTH), -(-length // mmap.PAGESIZE) * mmap.PAGESIZE
        check_share(peer, depth * length, self.held(), self.limits.memory_each_bytes, self.limits.memory_bytes)
        client = self._plane.adopt(os.dup(connection.fileno()))
        self._held[client] = _Held(peer, depth * length, connection.dup())
        made = self._thread.submit(lambda: _echo(depth, length) if echo else [self._take_of_port(length)])
        came = partial(self._answer_open, client, wanted)
        made.add_done_callback(lambda done: self._loop.call_threadsafe(partial(came, done)))

    def _answer_open(self, client: int, wanted: Open, taken: Future[list[DeviceMemory]]) -> None:
        held = self._held.get(client)
        if held is None or held.connection is None:  # it has gone
            if taken.exception() is None:
                self._free(taken.result())
            return
        with held.connection as connection:
            held.connection = None
            try:
                self._hand_over(client, held, wanted, taken)
            except (CmError, OSError) as error:
                self.gone(client)
                self._plane.drop(client)
                with suppress(OSError):
                    connection.send(encode_refusal(error))

    def _hand_over(self, client: int, held: _Held, wanted: Open, taken: Future[list[DeviceMemory]]) -> None:
        try:
            held.slots = taken.result()
        except DeviceNotFound:  # there is no port: from a channel only in this thread, which also opens streams
            held.slots = [self._take(wanted.length)]
        first, depth = held.slots[0], len(held.slots)
        held.bytes = depth * first.length
        held.stream = self._plane.start(None, StreamSetup(True, first.length, address=first.address))
        for slot in held.slots:
            self._plane.add_slot(held.stream, slot.fd)
        geometry = Geometry(
            first.length, wanted.length, coherent=first.coherent, writable=True, depth=depth, shape=(wanted.length,),
            stream="echo" if wanted.purpose is Purpose.ECHO else "memory",
        )  # fmt: skip
        self._plane.attach(client, held.stream, depth, encode_geometry(geometry))
        if wanted.purpose is Purpose.ALLOCATE:
            address = Descriptor(kind=ADDRESS, length=wanted.length, sequence=first.address)
            self._plane.tell(held.stream, address.pack())

    def _free(self, slots: list[DeviceMemory]) -> None:
        for slot in slots:  # its memory goes once the client has unmapped it
            self._thread.submit(slot.free)

    def gone(self, client: int) -> None:
        """Release the memory of a client of the plane that has gone, if it had any."""
        held = self._held.pop(client, None)
        if held is None:
            return
        if held.connection is not None:
            held.connection.close()
        if held.stream:
            self._plane.stop(held.stream)
        self._free(held.slots)

    def close(self) -> None:
        """Close the connections that still wait for memory, and wait until all is done that was begun."""
        for held in self._held.values():
            if held.connection is not None:
                held.connection.close()
                held.connection = None
        self._thread.shutdown()


def _echo(depth: int, length: int) -> list[DeviceMemory]:
    """The slots of an echo, which no hardware has an address for."""
    made: list[DeviceMemory] = []
    try:
        for _ in range(depth):
            fd = os.memfd_create("cm-echo", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            made.append(DeviceMemory(fd, length, coherent=True, address=0, free=partial(os.close, fd)))
            os.ftruncate(fd, length)
    except BaseException:
        for slot in made:
            slot.free()
        raise
    return made
