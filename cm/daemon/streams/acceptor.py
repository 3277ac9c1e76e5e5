# SPDX-License-Identifier: Apache-2.0
"""The socket ``data`` in the runtime folder: takes connections, and makes them clients of the data plane."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from cm.daemon.folders import share
from cm.daemon.loop import Loop
from cm.daemon.streams.allocations import Allocations
from cm.daemon.streams.echo import Echoes
from cm.daemon.streams.peer import Peer
from cm.errors import CmError
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Open, decode_open, encode_refused

_BACKLOG = 64
_WAITING = 64  # connections that have not said yet what they want; the oldest makes room


class Acceptor:
    """Listens; every connection says once what it wants. The loop's thread."""

    def __init__(
        self,
        loop: Loop,
        folder: Path,
        enter: Callable[[socket.socket, Open], None],
        echoes: Echoes,
        allocations: Allocations,
        check: Callable[[socket.socket, Open], None],
        group: int | None = None,
    ) -> None:
        """`check` raises Forbidden for what a connection has no right to; `group` may connect beside ourselves."""
        self._loop = loop
        self._path = folder.absolute() / packets.SOCKET
        self._enter = enter
        self._echoes = echoes
        self._allocations = allocations
        self._check = check
        self._group = group
        self._waiting: dict[int, socket.socket] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)

    def open(self) -> None:
        """Bind and listen; what a killed manager left is replaced (the folder is locked)."""
        self._path.unlink(missing_ok=True)
        self._listener.bind(str(self._path))
        share(self._path, self._group)
        self._listener.listen(_BACKLOG)
        self._loop.add(self._listener.fileno(), self._accept)

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return
        if len(self._waiting) >= _WAITING:
            self._forget(next(iter(self._waiting.values()))).close()
        connection.setblocking(False)
        self._waiting[connection.fileno()] = connection
        self._loop.add(connection.fileno(), lambda: self._first(connection))

    def _forget(self, connection: socket.socket) -> socket.socket:
        self._loop.remove(connection.fileno())
        return self._waiting.pop(connection.fileno())

    def _first(self, connection: socket.socket) -> None:
        self._forget(connection)
        with connection, suppress(OSError):
            packet = connection.recv(packets.PACKET_MAX)
            if not packet:
                return
            try:
                self._admit(connection, decode_open(packet))
            except CmError as error:
                connection.send(encode_refused(error.code, str(error)))
            except OSError as error:
                connection.send(encode_refused("device_error", str(error)))

    def _admit(self, connection: socket.socket, wanted: Open) -> None:
        self._check(connection, wanted)
        if wanted.echo:
            self._echoes.open(os.dup(connection.fileno()), wanted, Peer.of(connection))
        elif wanted.allocate:
            self._allocations.open(os.dup(connection.fileno()), wanted, Peer.of(connection))
        else:
            self._enter(connection, wanted)

    def close(self) -> None:
        """Hang up on all who have not said yet what they want."""
        self._loop.remove(self._listener.fileno())
        self._listener.close()
        self._path.unlink(missing_ok=True)
        for number, connection in self._waiting.items():
            self._loop.remove(number)
            connection.close()
        self._waiting.clear()
