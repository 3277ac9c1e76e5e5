# SPDX-License-Identifier: Apache-2.0
"""Memory without hardware: what a client submits is done at once. For measuring and for testing clients."""

from __future__ import annotations

import mmap
import os

from cm.daemon.streams.memory_budget import MemoryBudget
from cm.daemon.streams.peer import Peer
from cm.device.data_plane import Plane, StreamSetup
from cm.errors import InvalidRequest
from cm.wire.plane_packets import Geometry, Open, encode_geometry

_MAX_DEPTH = 16


class Echoes:
    """Each client of its own has its own memory, which goes with it."""

    def __init__(self, plane: Plane) -> None:
        self._plane = plane
        self.budget = MemoryBudget("memory of echoes")
        self._open: dict[int, tuple[int, list[int]]] = {}  # client → stream, descriptors

    def open(self, connection: int, wanted: Open, peer: Peer) -> None:
        """Give the connection of a process memory. Raises InvalidRequest, Busy."""
        depth = min(wanted.depth or 2, _MAX_DEPTH)
        length = -(-wanted.length // mmap.PAGESIZE) * mmap.PAGESIZE
        try:
            if length <= 0:
                raise InvalidRequest("an echo needs a length of at least one byte")
            self.budget.check(peer, depth * length)
            self.budget.took(self._make(connection, wanted.length, length, depth), peer, depth * length)
        except BaseException:
            os.close(connection)
            raise

    def _make(self, connection: int, frame: int, length: int, depth: int) -> int:
        fds: list[int] = []
        stream = self._plane.start(None, StreamSetup(write=True, length=length))
        try:
            for _ in range(depth):
                fds.append(os.memfd_create("cm-echo", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING))
                os.ftruncate(fds[-1], length)
                self._plane.add_slot(stream, fds[-1])
        except BaseException:
            self._free(stream, fds)
            raise
        client = self._plane.adopt(connection)
        self._open[client] = (stream, fds)
        geometry = Geometry(length, frame, writable=True, depth=depth, shape=(frame,), stream="echo")
        self._plane.attach(client, stream, depth, encode_geometry(geometry))
        return client

    def gone(self, client: int) -> None:
        """A client of the plane has gone; nothing if it had no echo."""
        self.budget.gone(client)
        stream, fds = self._open.pop(client, (0, []))
        if stream:
            self._free(stream, fds)

    def _free(self, stream: int, fds: list[int]) -> None:
        self._plane.stop(stream)
        for fd in fds:
            os.close(fd)
