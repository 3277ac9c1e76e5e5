# SPDX-License-Identifier: Apache-2.0
"""Clients of the data socket: other processes, which keep their connection while their stream is stopped."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass, replace

from cm.daemon.streams.peer import Peer
from cm.daemon.streams.stream import OpenStream
from cm.device.plane import Plane
from cm.errors import CmError
from cm.messages.status import ErrorInfo
from cm.wire.plane import Open


@dataclass(frozen=True, slots=True)
class _Local:
    """A client of the plane in another process."""

    stream: str
    depth: int
    peer: Peer
    leaving: bool = False  # it only holds frames yet


class LocalClients:
    """All of them, by their number in the plane. The loop's thread."""

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
        """It has hung up; the name of its stream, None where it was no client of ours."""
        local = self._clients.pop(client, None)
        return local.stream if local else None
