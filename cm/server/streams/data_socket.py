# SPDX-License-Identifier: Apache-2.0
"""The socket ``data`` in the runtime folder: lets connections in, and makes them clients of the data plane.

Each says once what it wants. A process that keeps connecting gets at most a quarter of the loop's time, and displaces
no other process.
"""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from cm.errors import Busy, CmError
from cm.loop import Timer
from cm.server.client_process import Peer
from cm.server.connections import Connections
from cm.server.long_work import RoundRobin
from cm.server.private_folders import share
from cm.server.sockets import Loop
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import PACKET_MAX, Open, Purpose, decode_open, encode_refused

WAITING = 64  # in total, three quarters from one process; beyond that, the process with the most loses its oldest
_AT_ONCE = 16  # connections accepted in one turn of the loop
_REST = 3.0  # pause before accepting more, as a multiple of the time that the last ones took
_SHORTEST = 0.002  # the shortest such pause, in seconds


class AwaitingOpen:
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
            most = name if held[name] >= WAITING * 3 // 4 else held.most_common(1)[0][0]
            self._forget(next(one for one, whose in self._waiting.items() if whose == most)).close()
        connection.setblocking(False)
        self._waiting[connection] = name
        self._loop.add(connection.fileno(), lambda: self._first(connection))

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


_BACKLOG = 256  # connections that the kernel keeps waiting
_QUEUED = 64  # connections that have said what they want, and wait for their turn


Serve = Callable[[socket.socket, Open, Peer], Iterator[object] | None]  # the caller closes the connection


class DataSocket:
    """Listens; each connection says once what it wants. Used in the loop's thread."""

    def __init__(
        self,
        loop: Loop,
        folder: Path,
        serve: Mapping[Purpose, Serve],
        rights: Connections,
        turns: RoundRobin,
        group: int | None = None,
    ) -> None:
        """`serve`: what each purpose does, in the steps that it may return. `group`: may connect, beside our user."""
        self._loop = loop
        self._path = folder.absolute() / packets.SOCKET
        self._serves = serve
        self._rights = rights
        self._turns = turns
        self._group = group
        self._queued: dict[socket.socket, str] = {}  # connections not yet served, and their processes
        self._under_way: dict[socket.socket, Generator[object, None, None]] = {}
        # SEQPACKET keeps packets apart, and file descriptors (SCM_RIGHTS) with the packet that carries them.
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._awaiting = AwaitingOpen(loop, self._listener, rights.whose, self._queue)

    def open(self) -> None:
        """Bind and listen, replacing the socket that a killed manager left (the folder is locked, so it is dead)."""
        self._path.unlink(missing_ok=True)
        self._listener.bind(str(self._path))
        share(self._path, self._group)
        self._listener.listen(_BACKLOG)
        self._awaiting.open()

    def _queue(self, connection: socket.socket, packet: bytes) -> None:
        """Queue a connection for its turn: opening streams and allocating slots hold up the loop."""
        try:
            who = self._rights.whose(connection)
            self._check_place(who)
        except (Busy, OSError) as error:
            with connection, suppress(OSError):
                if isinstance(error, Busy):
                    connection.send(encode_refused(error.code, str(error)))
            return
        self._queued[connection] = who
        steps = self._under_way[connection] = self._serve(connection, packet)
        self._turns.run(steps)

    def _check_place(self, who: str) -> None:
        """Raise Busy if as many wait as may; a quarter is for processes that have few."""
        own = sum(other == who for other in self._queued.values())
        if len(self._queued) >= _QUEUED or own >= _QUEUED * 3 // 4:
            raise Busy(
                f"{own} connections of this process and {len(self._queued)} of all wait for their turn, of {_QUEUED}, "
                "the last of which are for others; try again when one has ended"
            )

    def _serve(self, connection: socket.socket, packet: bytes) -> Generator[object, None, None]:
        try:
            with connection, suppress(OSError):
                try:
                    wanted = decode_open(packet)
                    self._rights.check_open(self._queued[connection], wanted)
                    yield from self._serves[wanted.purpose](connection, wanted, Peer.of(connection)) or ()
                except CmError as error:
                    connection.send(encode_refused(error.code, str(error)))
                except OSError as error:
                    connection.send(encode_refused("device_error", str(error)))
        finally:
            self._queued.pop(connection, None)
            del self._under_way[connection]

    def close(self) -> None:
        """Close all connections that have not been served yet."""
        self._awaiting.close()
        for steps in list(self._under_way.values()):
            steps.close()
        self._listener.close()
        self._path.unlink(missing_ok=True)
        for connection in self._queued:
            connection.close()
        self._queued.clear()
