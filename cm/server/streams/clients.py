# SPDX-License-Identifier: Apache-2.0
"""The clients of open streams: other processes over the data socket, and the daemon itself for ZeroMQ."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from cm.device.data_plane import Plane
from cm.errors import CmError
from cm.server.loop import Loop
from cm.server.streams.over_zmq import ZmqReader, ZmqWriter
from cm.server.streams.peer import Peer
from cm.server.streams.stream import Frame, OpenStream
from cm.wire.messages.status import ErrorInfo
from cm.wire.plane_packets import Open


@dataclass(frozen=True, slots=True)
class _Local:
    """A client of the plane in another process."""

    stream: str
    depth: int
    peer: Peer
    leaving: bool = False  # it only holds frames yet


class LocalClients:
    """Clients of the data socket, by their number in the plane, which they keep while their stream is stopped."""

    def __init__(self, plane: Plane, on_error: Callable[[ErrorInfo], None]) -> None:
        self._plane = plane
        self._on_error = on_error
        self._clients: dict[int, _Local] = {}

    def adopt(
        self, connection: socket.socket, wanted: Open, stream: str, join: Callable[[int, Peer], Iterator[None]]
    ) -> Iterator[None]:
        """Make a connection a client of a stream, in the steps that `join` returns; the caller closes the connection.

        Raises what the steps raise; the connection is then no longer a client.
        """
        peer = Peer.of(connection)
        client = self._plane.adopt(os.dup(connection.fileno()))
        try:
            steps = join(client, peer)
            self._clients[client] = _Local(stream, wanted.depth, peer)  # from here on it is the stream's client
            yield from steps
        except BaseException:
            self._clients.pop(client, None)
            self._plane.drop(client)
            raise

    def use(self, stream: str) -> bool:
        """Whether a stream has clients that still want frames, or to write them."""
        return any(local.stream == stream and not local.leaving for local in self._clients.values())

    def attach_all(self, opened: OpenStream) -> list[tuple[int, Iterator[None]]]:
        """The clients that wait for a stream, each with the steps by which it joins."""
        waiting = []
        for client, local in list(self._clients.items()):
            if local.stream == opened.stream.name and not local.leaving:
                try:
                    waiting.append((client, opened.holders.join(client, local.depth, local.peer)))
                except CmError as error:
                    self.refused(opened, client, error)
        return waiting

    def refused(self, opened: OpenStream, client: int, error: CmError | OSError) -> None:
        """Disconnect a client that waited, because there is no memory for it, and report the error."""
        self._clients.pop(client, None)
        self._plane.drop(client)
        self._on_error(ErrorInfo("no_slots", f"a client of {opened.stream.name!r} was hung up on: {error}"))

    def leaves(self, client: int) -> None:
        """The client keeps the slots that it holds, but the stream no longer runs for its sake."""
        if client in self._clients:
            self._clients[client] = replace(self._clients[client], leaving=True)

    def gone(self, client: int) -> str | None:
        """Remove a client that has hung up; return the name of its stream, or None for a client not known here."""
        local = self._clients.pop(client, None)
        return local.stream if local else None


TakeSteps = Callable[[OpenStream, Iterator[None], Callable[[CmError | OSError], object]], None]


class ZmqClients:
    """The daemon's own clients for ZeroMQ: at most one per stream, made when it is needed."""

    def __init__(self, loop: Loop, plane: Plane, deliver: Callable[[Frame], None], take_steps: TakeSteps) -> None:
        """`take_steps` takes the steps by which a client joins a stream; it passes an error to the function given."""
        self._loop = loop
        self._plane = plane
        self._deliver = deliver
        self._take_steps = take_steps
        self._clients: dict[str, ZmqReader | ZmqWriter] = {}

    def reader(self, opened: OpenStream) -> ZmqReader:
        """Return the client that reads an open stream."""
        found = self._clients.get(opened.stream.name)
        if not isinstance(found, ZmqReader):
            found = ZmqReader(self._loop, self._plane, opened, self._deliver)
            self._joins(opened, found)
        return found

    def writer(self, opened: OpenStream) -> ZmqWriter:
        """Return the client that writes to an open stream."""
        found = self._clients.get(opened.stream.name)
        if not isinstance(found, ZmqWriter):
            found = ZmqWriter(self._loop, self._plane, opened)
            self._joins(opened, found)
        return found

    def _joins(self, opened: OpenStream, made: ZmqReader | ZmqWriter) -> None:
        self._clients[opened.stream.name] = made
        self._take_steps(opened, made.steps, lambda error: self._refused(opened, made, error))

    def _refused(self, opened: OpenStream, made: ZmqReader | ZmqWriter, error: CmError | OSError) -> None:
        """There are no slots for this client: its waiting requests get the error."""
        if self._clients.get(opened.stream.name) is made:
            del self._clients[opened.stream.name]
            made.close(error)

    def busy(self, name: str) -> bool:
        """Whether a single read or write is under way, or was a moment ago."""
        found = self._clients.get(name)
        return found is not None and found.busy

    def working(self, name: str) -> bool:
        """Whether a single read or write is under way."""
        found = self._clients.get(name)
        return found is not None and found.working

    def refresh(self, opened: OpenStream, subscribed: bool) -> None:
        """Read frames while there are subscribers; close a client that has nothing to do."""
        found = self._clients.get(opened.stream.name)
        if found is None and subscribed:
            self.reader(opened)
        elif found is not None and not found.busy and not subscribed:
            self.close(opened.stream.name)

    def close(self, name: str, error: CmError | OSError | None = None) -> None:
        """Close a stream's client; waiting requests get the error, or are told that the stream was stopped."""
        found = self._clients.pop(name, None)
        if found is not None:
            found.close(error)
