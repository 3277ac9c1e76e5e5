# SPDX-License-Identifier: Apache-2.0
"""Memory for masters in the PL, such as HLS kernels with `m_axi`; it is freed when its client hangs up."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial

from cm.daemon.host.memory import DeviceMemory
from cm.daemon.streams.memory_budget import MemoryBudget
from cm.daemon.streams.memory_thread import MemoryThread
from cm.daemon.streams.peer import Peer
from cm.device import DeviceNotFound
from cm.device.data_plane import Plane, StreamSetup
from cm.errors import CmError, InvalidRequest
from cm.wire.plane_packets import ADDRESS, Descriptor, Geometry, Open, encode_geometry, encode_refused

Take = Callable[[int], DeviceMemory]


class Allocations:
    """The memories of clients of the data socket, by their number in the plane. The loop's thread."""

    def __init__(self, plane: Plane, thread: MemoryThread, take_of_port: Take, take: Take) -> None:
        """`take` memory from whatever gives it; from a configuration port, it may be taken in another thread."""
        self._plane = plane
        self._thread = thread
        self._take_of_port = take_of_port
        self._take = take
        self.budget = MemoryBudget("memory for masters in the PL")
        self._coming: dict[int, socket.socket] = {}  # of clients whose memory is being allocated
        self._open: dict[int, tuple[int, DeviceMemory]] = {}  # client → stream, memory

    def open(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        """Give the connection of a process memory, soon, or refuse that. Raises InvalidRequest, Busy."""
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
        """A channel is claimed while it gives memory, so only here, where streams are opened."""
        try:
            return taken.result()
        except DeviceNotFound:
            return self._take(length)

    def _hand_over(self, client: int, memory: DeviceMemory, length: int, peer: Peer) -> None:
        try:
            stream = self._plane.start(None, StreamSetup(write=True, length=memory.length))
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
        """A client of the plane has gone; nothing if it had no memory."""
        coming = self._coming.pop(client, None)
        if coming is not None:
            coming.close()
        _, memory = self._open.get(client, (0, None))
        if memory is not None:
            self._free(client, memory)
        self.budget.gone(client)

    def close(self) -> None:
        """Nothing is handed over any more."""
        for connection in self._coming.values():
            connection.close()
        self._coming.clear()
