# SPDX-License-Identifier: Apache-2.0
"""Memory without hardware: what a client submits is done at once. For measuring, and for trying clients out."""

from __future__ import annotations

import mmap
import os

from cm.device.data_plane import Plane, StreamSetup
from cm.errors import Busy, InvalidRequest
from cm.wire.plane_packets import Geometry, Open, encode_geometry

_MAX_BYTES = 256 << 20  # of all echoes together
_MAX_DEPTH = 16


class Echoes:
    """Each client of its own has its own memory, which goes with it."""

    def __init__(self, plane: Plane) -> None:
        self._plane = plane
        self._open: dict[int, tuple[int, list[int], int]] = {}  # client → stream, descriptors, bytes

    def open(self, connection: int, wanted: Open) -> None:
        """Give a connection memory. Raises InvalidRequest, Busy."""
        depth = min(wanted.depth or 2, _MAX_DEPTH)
        length = -(-wanted.length // mmap.PAGESIZE) * mmap.PAGESIZE
        used = sum(size for _, _, size in self._open.values())
        try:
            if length <= 0:
                raise InvalidRequest("an echo needs a length of at least one byte")
            if used + depth * length > _MAX_BYTES:
                raise Busy(f"echoes may have {_MAX_BYTES >> 20} MiB together; this one wants {depth} times {length}")
            self._make(connection, wanted.length, length, depth)
        except BaseException:
            os.close(connection)
            raise

    def _make(self, connection: int, frame: int, length: int, depth: int) -> None:
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
        self._open[client] = (stream, fds, depth * length)
        geometry = Geometry(length, frame, writable=True, depth=depth, shape=(frame,), stream="echo")
        self._plane.attach(client, stream, depth, encode_geometry(geometry))

    def gone(self, client: int) -> None:
        """A client of the plane has gone; nothing if it had no echo."""
        stream, fds, _ = self._open.pop(client, (0, [], 0))
        if stream:
            self._free(stream, fds)

    def _free(self, stream: int, fds: list[int]) -> None:
        self._plane.stop(stream)
        for fd in fds:
            os.close(fd)
