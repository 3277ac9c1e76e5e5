# SPDX-License-Identifier: Apache-2.0
"""Memory for masters in the PL, such as HLS kernels with `m_axi`; freed when its client hangs up."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial

from cm.device import DeviceNotFound
from cm.device.data_plane import Plane, StreamSetup
from cm.errors import CmError, InvalidRequest
from cm.server.host.memory import DeviceMemory
from cm.server.streams.memory_budget import MemoryBudget
from cm.server.streams.memory_thread import MemoryThread
from cm.server.streams.peer import Peer
from cm.wire.plane_packets import ADDRESS, Descriptor, Geometry, Open, encode_geometry, encode_refused

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
