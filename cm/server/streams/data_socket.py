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
from functools import partial
from pathlib import Path

from cm.errors import Busy, CmError
from cm.loop import Timer
from cm.server.client_process import Peer
from cm.server.connections import Connections
from cm.server.error_replies import encode_refusal
from cm.server.long_work import RoundRobin
from cm.server.private_folders import share
from cm.server.sockets import Loop
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import PACKET_MAX, Open, Purpose, decode_open

WAITING = 64  # in total, three quarters from one process; beyond that, the process with the most loses its oldest
_AT_ONCE = 16  # connections accepted in one turn of the loop
_REST = 3.0  # pause before accepting more, as a multiple of the time that the last ones took
_SHORTEST = 0.002  # the shortest such pause, in seconds
_BACKLOG = 256  # connections that the kernel keeps waiting
_QUEUED = 64  # connections that have said what they want, and wait for their turn

Serve = Callable[[socket.socket, Open, Peer], Iterator[object] | None]  # the caller closes the connection


class DataSocket:
    """Listens, and reads the first packet of each connection. Used in the loop's thread."""

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
        self._waiting: dict[socket.socket, str] = {}  # connections that said nothing yet, in order of arrival
        self._resting: Timer | None = None
        self._queued: dict[socket.socket, str] = {}  # connections not yet served, and their processes
        self._under_way: dict[socket.socket, Generator[object, None, None]] = {}
        # SEQPACKET keeps packets apart, and file descriptors (SCM_RIGHTS) with the packet that carries them.
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)

    def open(self) -> None:
        """Bind and listen, replacing the socket that a killed manager left (the folder is locked, so it is dead)."""
        self._path.unlink(missing_ok=True)
        self._listener.bind(str(self._path))
        share(self._path, self._group)
        self._listener.listen(_BACKLOG)
        self._loop.add(self._listener.fileno(), self._accept)

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
            name = self._rights.whose(connection)
        except OSError:  # it has gone
            connection.close()
            return
        held = Counter(self._waiting.values())
        if held[name] >= WAITING * 3 // 4 or held.total() >= WAITING:
            most = name if held[name] >= WAITING * 3 // 4 else held.most_common(1)[0][0]
            oldest = next(one for one, whose in self._waiting.items() if whose == most)
            self._forget(oldest)
            oldest.close()
        connection.setblocking(False)
        self._waiting[connection] = name
        self._loop.add(connection.fileno(), partial(self._read_open, connection))

    def _forget(self, connection: socket.socket) -> str:
        self._loop.remove(connection.fileno())
        return self._waiting.pop(connection)

    def _read_open(self, connection: socket.socket) -> None:
        """What it wants waits for its turn: opening streams and allocating slots hold up the loop."""
        who, packet = self._forget(connection), b""
        with suppress(OSError):
            packet = connection.recv(PACKET_MAX)
        own = sum(other == who for other in self._queued.values())
        if packet and len(self._queued) < _QUEUED and own < _QUEUED * 3 // 4:  # a quarter is for who has few
            self._queued[connection] = who
            steps = self._under_way[connection] = self._serve(connection, packet)
            self._turns.run(steps)
            return
        with connection, suppress(OSError):
            if packet:
                busy = Busy(
                    f"{own} connections of this process and {len(self._queued)} of all wait for their turn, of "
                    f"{_QUEUED}, the last of which are for others; try again when one has ended"
                )
                connection.send(encode_refusal(busy))

    def _serve(self, connection: socket.socket, packet: bytes) -> Generator[object, None, None]:
        try:
            with connection, suppress(OSError):
                try:
                    wanted = decode_open(packet)
                    self._rights.check_open(self._queued[connection], wanted)
                    yield from self._serves[wanted.purpose](connection, wanted, Peer.of(connection)) or ()
                except (CmError, OSError) as error:
                    connection.send(encode_refusal(error))
        finally:
            self._queued.pop(connection, None)
            del self._under_way[connection]

    def close(self) -> None:
        """Close all connections that have not been served yet."""
        if self._resting is not None:
            self._resting.cancel()
        self._loop.remove(self._listener.fileno())
        for steps in list(self._under_way.values()):
            steps.close()
        self._listener.close()
        self._path.unlink(missing_ok=True)
        for connection in self._waiting:
            self._loop.remove(connection.fileno())
        for connection in (*self._waiting, *self._queued):
            connection.close()
        self._waiting.clear()
        self._queued.clear()
