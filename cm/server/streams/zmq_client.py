# SPDX-License-Identifier: Apache-2.0
"""The ZeroMQ side of a stream: the daemon as a client of its own data plane, on behalf of ZeroMQ clients.

It is a client like any other, connected by a socket pair. Reading and writing are in `zmq_reader` and `zmq_writer`.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

from cm.device.data_plane import Plane, StreamSetup
from cm.errors import CmError
from cm.server.loop import Loop
from cm.server.streams.stream import OpenStream
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import DESCRIPTOR, Descriptor

_LINGER = 2.0  # seconds that a stream stays open after a single read or write


class ZmqClient:
    """A client of the plane in this process."""

    def __init__(self, loop: Loop, plane: Plane, opened: OpenStream, depth: int) -> None:
        self._loop, self._plane, self._stream = loop, plane, opened
        self._used_at = 0.0
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._socket = ours
        self.client = plane.adopt(theirs.detach())
        try:
            self.steps = opened.joiners.join(self.client, depth)  # by which it joins the stream
        except BaseException:
            plane.drop(self.client)
            ours.close()
            raise
        loop.add(ours.fileno(), self._readable)

    @property
    def working(self) -> bool:
        """Whether a request is waiting now."""
        raise NotImplementedError

    @property
    def busy(self) -> bool:
        """Whether a request is waiting, or was a moment ago."""
        return self.working or time.monotonic() < self._used_at + _LINGER

    def close(self, error: CmError | OSError | None = None) -> None:  # noqa: ARG002 (for subclasses)
        """Disconnect; waiting requests get the error, or are told that the stream was stopped."""
        self._loop.remove(self._socket.fileno())
        self._plane.drop(self.client)
        self._stream.joiners.detached(self.client)
        self._socket.close()

    def _readable(self) -> None:
        try:
            packet = self._socket.recv(packets.PACKET_MAX)  # descriptors of memory that come with it are closed
        except BlockingIOError:
            return
        if len(packet) >= DESCRIPTOR.size:
            self._take(Descriptor(*DESCRIPTOR.unpack_from(packet)))

    def _take(self, packet: Descriptor) -> None:
        raise NotImplementedError


def line_slices(setup: StreamSetup) -> Iterator[slice]:
    """The bytes of each line of a video frame in its slot."""
    for begin in range(0, setup.lines * setup.stride, setup.stride):
        yield slice(begin, begin + setup.line_bytes)
