# SPDX-License-Identifier: Apache-2.0
"""Memory without hardware: what a client submits is complete at once. For measuring and testing clients."""

from __future__ import annotations

import mmap
import os
import socket
from collections.abc import Iterator

from cm.device.data_plane import Plane, StreamSetup
from cm.errors import InvalidRequest
from cm.server.streams.memory_budget import MemoryBudget
from cm.server.streams.memory_thread import MemoryThread
from cm.server.streams.peer import Peer
from cm.wire.plane_packets import Geometry, Open, encode_geometry

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
            self._thread.run(lambda: _close(fds))  # frees the memory if the client has unmapped it


def _close(fds: list[int]) -> None:
    for fd in fds:
        os.close(fd)
