# SPDX-License-Identifier: Apache-2.0
"""The daemon's own clients of open streams: at most one each, that reads or writes for ZeroMQ."""

from __future__ import annotations

from collections.abc import Callable

from cm.daemon.loop import Loop
from cm.daemon.streams.stream import Frame, OpenStream
from cm.daemon.streams.zmq_bridge import ZmqReader, ZmqWriter
from cm.device.plane import Plane


class ZmqClients:
    """Made when they are needed, by the name of their stream. The loop's thread."""

    def __init__(self, loop: Loop, plane: Plane, deliver: Callable[[Frame], None]) -> None:
        self._loop = loop
        self._plane = plane
        self._deliver = deliver
        self._clients: dict[str, ZmqReader | ZmqWriter] = {}

    def reader(self, opened: OpenStream) -> ZmqReader:
        """What reads an open stream."""
        found = self._clients.get(opened.stream.name)
        if not isinstance(found, ZmqReader):
            found = ZmqReader(self._loop, self._plane, opened, self._deliver)
            self._clients[opened.stream.name] = found
        return found

    def writer(self, opened: OpenStream) -> ZmqWriter:
        """What writes to an open stream."""
        found = self._clients.get(opened.stream.name)
        if not isinstance(found, ZmqWriter):
            found = self._clients[opened.stream.name] = ZmqWriter(self._loop, self._plane, opened)
        return found

    def busy(self, name: str) -> bool:
        """Whether a single read or write is under way, or was a moment ago."""
        found = self._clients.get(name)
        return found is not None and found.busy

    def working(self, name: str) -> bool:
        """Whether a single read or write is under way."""
        found = self._clients.get(name)
        return found is not None and found.working

    def refresh(self, opened: OpenStream, subscribed: bool) -> None:
        """Frames are read while there are subscribers; a client that has nothing to do goes."""
        found = self._clients.get(opened.stream.name)
        if found is None and subscribed:
            self.reader(opened)
        elif found is not None and not found.busy and not subscribed:
            self.close(opened.stream.name)

    def close(self, name: str) -> None:
        """Hang up on a stream; those who wait are told that it was stopped."""
        found = self._clients.pop(name, None)
        if found is not None:
            found.close()
