# SPDX-License-Identifier: Apache-2.0
"""Connections to the data socket that have not yet said what they want."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable

from cm.server.loop import Loop, Timer
from cm.wire.plane_packets import PACKET_MAX

WAITING = 64  # in total, three quarters from one process; beyond that, the process with the most loses its oldest
_AT_ONCE = 16  # connections accepted in one turn of the loop
_REST = 3.0  # pause before accepting more, as a multiple of the time that the last ones took
_SHORTEST = 0.002  # the shortest such pause, in seconds


class Newcomers:
    """Accepts connections and reads the first packet of each. Used in the loop's thread.

    A process that keeps connecting gets at most a quarter of the loop's time, and displaces no other process.
    """

    def __init__(
        self,
        loop: Loop,
        listener: socket.socket,
        whose: Callable[[socket.socket], str],
        heard: Callable[[socket.socket, bytes], None],
    ) -> None:
        """`whose`: returns a connection's process, or raises OSError. `heard`: takes over the connection."""
        self._loop = loop
        self._listener = listener
        self._whose = whose
        self._heard = heard
        self._waiting: dict[socket.socket, str] = {}  # connections and their processes, in order of arrival
        self._resting: Timer | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def open(self) -> None:
        """Start accepting; the listener must be bound."""
        self._loop.add(self._listener.fileno(), self._accept)

    def close(self) -> None:
        """Close all connections."""
        if self._resting is not None:
            self._resting.cancel()
        self._loop.remove(self._listener.fileno())
        for connection in list(self._waiting):
            self._forget(connection).close()

    def _accept(self) -> None:
        began = time.monotonic()
        for _ in range(_AT_ONCE):
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                return
            except ConnectionAbortedError:
                continue
            except OSError:  # out of file descriptors: pending connections stay in the backlog
                break
            self._let_in(connection)
        self._loop.pause(self._listener.fileno())
        self._resting = self._loop.call_later(max(_SHORTEST, _REST * (time.monotonic() - began)), self._rested)

    def _rested(self) -> None:
        self._resting = None
        self._loop.resume(self._listener.fileno())

    def _let_in(self, connection: socket.socket) -> None:
        try:
            name = self._whose(connection)
        except OSError:  # it has gone
            connection.close()
            return
        held = Counter(self._waiting.values())
        if held[name] >= WAITING * 3 // 4 or held.total() >= WAITING:
            self._make_room(name if held[name] >= WAITING * 3 // 4 else held.most_common(1)[0][0])
        connection.setblocking(False)
        self._waiting[connection] = name
        self._loop.add(connection.fileno(), lambda: self._first(connection))

    def _make_room(self, name: str) -> None:
        self._forget(next(one for one, whose in self._waiting.items() if whose == name)).close()

    def _forget(self, connection: socket.socket) -> socket.socket:
        self._loop.remove(connection.fileno())
        del self._waiting[connection]
        return connection

    def _first(self, connection: socket.socket) -> None:
        self._forget(connection)
        try:
            packet = connection.recv(PACKET_MAX)
        except OSError:
            packet = b""
        if packet:
            self._heard(connection, packet)
        else:
            connection.close()
