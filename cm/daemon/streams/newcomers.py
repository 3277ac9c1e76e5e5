# SPDX-License-Identifier: Apache-2.0
"""Connections to the data socket that have not said yet what they want."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from cm.daemon.loop import Loop, Timer
from cm.wire.plane_packets import PACKET_MAX

WAITING = 64  # of all; of one process three quarters. Beyond that the oldest goes of who has most
_AT_ONCE = 16  # that are accepted in one turn of the loop
_REST = 3.0  # so many times what that took, nobody else is
_SHORTEST = 0.002  # seconds of that


class Spender(Protocol):
    """Whose time it is (`cm.budgets.budget.Budget`)."""

    def charge(self, nanoseconds: int) -> None:
        """It took so much of the loop's time."""


class Newcomers:
    """Accepts connections, and reads the first packet of each. The loop's thread.

    A process that connects again and again gets a quarter of the loop's time for it at most, and pushes out no others.
    """

    def __init__(
        self,
        loop: Loop,
        listener: socket.socket,
        whose: Callable[[socket.socket], tuple[str, Spender]],
        heard: Callable[[socket.socket, bytes], None],
    ) -> None:
        """`whose`: the process of a connection, and its budget; raises OSError. `heard` gets the connection itself."""
        self._loop = loop
        self._listener = listener
        self._whose = whose
        self._heard = heard
        self._waiting: dict[socket.socket, str] = {}  # and whose it is, in the order in which they came
        self._resting: Timer | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def open(self) -> None:
        """Begin; the listener is bound."""
        self._loop.add(self._listener.fileno(), self._accept)

    def close(self) -> None:
        """Hang up on all."""
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
            except OSError:  # no descriptor is left: who waits goes on waiting
                break
            self._let_in(connection)
        self._loop.pause(self._listener.fileno())
        self._resting = self._loop.call_later(max(_SHORTEST, _REST * (time.monotonic() - began)), self._rested)

    def _rested(self) -> None:
        self._resting = None
        self._loop.resume(self._listener.fileno())

    def _let_in(self, connection: socket.socket) -> None:
        began = time.monotonic_ns()
        try:
            name, spender = self._whose(connection)
        except OSError:  # it has gone
            connection.close()
            return
        held = Counter(self._waiting.values())
        if held[name] >= WAITING * 3 // 4 or held.total() >= WAITING:
            self._make_room(name if held[name] >= WAITING * 3 // 4 else held.most_common(1)[0][0])
        connection.setblocking(False)
        self._waiting[connection] = name
        self._loop.add(connection.fileno(), lambda: self._first(connection, spender))
        spender.charge(time.monotonic_ns() - began)

    def _make_room(self, name: str) -> None:
        self._forget(next(one for one, whose in self._waiting.items() if whose == name)).close()

    def _forget(self, connection: socket.socket) -> socket.socket:
        self._loop.remove(connection.fileno())
        del self._waiting[connection]
        return connection

    def _first(self, connection: socket.socket, spender: Spender) -> None:
        began = time.monotonic_ns()
        self._forget(connection)
        try:
            packet = connection.recv(PACKET_MAX)
        except OSError:
            packet = b""
        if packet:
            self._heard(connection, packet)
        else:
            connection.close()
        spender.charge(time.monotonic_ns() - began)
