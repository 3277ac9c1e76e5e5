# SPDX-License-Identifier: Apache-2.0
"""Memory for masters in the PL, such as HLS kernels with `m_axi`; it is freed when its client hangs up."""

from __future__ import annotations

import os
from collections.abc import Callable

from cm.daemon.host.memory import DeviceMemory
from cm.daemon.streams.memory_budget import MemoryBudget
from cm.daemon.streams.peer import Peer
from cm.device.data_plane import Plane, StreamSetup
from cm.errors import InvalidRequest
from cm.wire.plane_packets import ADDRESS, Descriptor, Geometry, Open, encode_geometry


class Allocations:
    """The memories of clients of the data socket, by their number in the plane."""

    def __init__(self, plane: Plane, take: Callable[[int], DeviceMemory]) -> None:
        self._plane = plane
        self._take = take
        self.budget = MemoryBudget("memory for masters in the PL")
        self._open: dict[int, tuple[int, DeviceMemory]] = {}  # client → stream, memory

    def open(self, connection: int, wanted: Open, peer: Peer) -> None:
        """Give the connection of a process memory. Raises InvalidRequest, Busy, DeviceError."""
        try:
            memory = self._take(self._checked(wanted.length, peer))
            try:
                self._hand_over(connection, memory, wanted.length, peer)
            except BaseException:
                memory.free()
                raise
        except BaseException:
            os.close(connection)
            raise

    def _checked(self, length: int, peer: Peer) -> int:
        if length <= 0:
            raise InvalidRequest("memory has at least one byte")
        self.budget.check(peer, length)
        return length

    def _hand_over(self, connection: int, memory: DeviceMemory, length: int, peer: Peer) -> None:
        stream = self._plane.start(None, StreamSetup(write=True, length=memory.length))
        self._plane.add_slot(stream, memory.fd)
        client = self._plane.adopt(connection)
        self._open[client] = (stream, memory)
        self.budget.took(client, peer, memory.length)
        geometry = Geometry(
            memory.length, length, coherent=memory.coherent, writable=True, depth=1, shape=(length,), stream="memory"
        )
        self._plane.attach(client, stream, 1, encode_geometry(geometry))
        self._plane.tell(stream, Descriptor(kind=ADDRESS, length=length, sequence=memory.address).pack())

    def gone(self, client: int) -> None:
        """A client of the plane has gone; nothing if it had no memory."""
        stream, memory = self._open.pop(client, (0, None))
        if memory is not None:
            self.budget.gone(client)
            self._plane.stop(stream)
            memory.free()
