# SPDX-License-Identifier: Apache-2.0
"""The clients of open streams: other processes over the data socket, and the daemon itself for ZeroMQ."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass, replace

from cm.daemon.loop import Loop
from cm.daemon.streams.peer import Peer
from cm.daemon.streams.stream import Frame, OpenStream
from cm.daemon.streams.zmq_reader import ZmqReader
from cm.daemon.streams.zmq_writer import ZmqWriter
from cm.device.data_plane import Plane
from cm.errors import CmError
from cm.messages.status import ErrorInfo
from cm.wire.plane_packets import Open


@dataclass(frozen=True, slots=True)
class _Local:
    """A client of the plane in another process."""

    stream: str
    depth: int
    peer: Peer
    leaving: bool = False  # it only holds frames yet


class LocalClients:
    """Clients of the data socket, by their number in the plane; they keep it while their stream is stopped."""

    def __init__(self, plane: Plane, on_error: Callable[[ErrorInfo], None]) -> None:
        self._plane = plane
        self._on_error = on_error
        self._clients: dict[int, _Local] = {}

    def adopt(self, connection: socket.socket, wanted: Open, attach: Callable[[int, Peer], str]) -> None:
        """Make a connection a client of the stream that `attach` names; the caller closes it. Raises as that does."""
        peer = Peer.of(connection)
        client = self._plane.adopt(os.dup(connection.fileno()))
        try:
            stream = attach(client, peer)
        except BaseException:
            self._plane.drop(client)
            raise
        self._clients[client] = _Local(stream, wanted.depth, peer)

    def use(self, stream: str) -> bool:
        """Whether a stream has clients that want more of it."""
        return any(local.stream == stream and not local.leaving for local in self._clients.values())

    def attach_all(self, opened: OpenStream) -> None:
        """Clients that wait for a stream get it back. What there is no memory for is hung up on, and told."""
        for client, local in list(self._clients.items()):
            if local.stream == opened.stream.name and not local.leaving:
                self._attach(opened, client, local)

    def _attach(self, opened: OpenStream, client: int, local: _Local) -> None:
        try:
            opened.attach(client, local.depth, local.peer)
        except (CmError, OSError) as error:
            self._plane.drop(client)
            self._on_error(ErrorInfo("no_slots", f"a client of {opened.stream.name!r} was hung up on: {error}"))

    def leaves(self, client: int) -> None:
        """What it holds stays its own, but nothing runs for it any more."""
        if client in self._clients:
            self._clients[client] = replace(self._clients[client], leaving=True)

    def gone(self, client: int) -> str | None:
        """It has hung up; the name of its stream, None where it was not a client of ours."""
        local = self._clients.pop(client, None)
        return local.stream if local else None


class ZmqClients:
    """At most one client for ZeroMQ of each stream, made when it is needed."""

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
