# SPDX-License-Identifier: Apache-2.0
"""The connections of this process as the kernel has them: whose they are, and their end.

libzmq has no call that closes one client's connection. But every connection is a descriptor of this process, and the
kernel says where it leads, so those that have to end are shut down beneath libzmq: when the policy changes, or where a
client takes more than it may. Honest clients connect again, and get their present rights.
"""

from __future__ import annotations

import fcntl
import logging
import os
import resource
import socket
import stat
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from cm.errors import Forbidden
from cm.manager.manager import Manager
from cm.manager.planner import target
from cm.manager.touched import Scene
from cm.server.client_quotas import place_of
from cm.server.rights.admission import Gate
from cm.server.rights.model import Access
from cm.server.rights.principal import DATA, IPC, Principal, from_id, of_process
from cm.server.rights.required_rights import OPENING, needs_of
from cm.server.streams.client_process import credentials
from cm.wire.plane_packets import SOCKET, Open
from cm.wire.topics import Endpoints

_LOG = logging.getLogger("cm")
_DESCRIPTORS = 65536  # requested, if as many are allowed: libzmq ends its process when it has none for a connection
_OUTQ = 0x5411  # SIOCOUTQ: bytes that the other end has not taken yet
_STUCK, _LOOK = 0.1, 0.05  # seconds without taking anything, and between two looks
_TOPICS = ("pub", "sub", "req")


def raise_descriptors() -> None:
    """Allow this process as many descriptors as it may have, up to 65,536."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _DESCRIPTORS if hard == resource.RLIM_INFINITY else min(_DESCRIPTORS, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def sockets() -> Iterator[socket.socket]:
    """All sockets of this process, each as a copy that has to be closed."""
    for number in (int(path.name) for path in Path("/proc/self/fd").iterdir()):
        try:
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                yield socket.socket(fileno=os.dup(number))
        except OSError:  # gone meanwhile
            continue


class Connections:
    """Those over ZeroMQ: of the sockets in a runtime folder, and of TCP ports. The loop's thread."""

    def __init__(self, folder: Path, tcp: list[Endpoints]) -> None:
        """`tcp` grows as ports are bound."""
        self._paths = {name: str(folder.absolute() / name) for name in _TOPICS}
        self._tcp = tcp
        self._stuck: dict[tuple[int, str], tuple[int, float]] = {}  # by inode and peer: bytes, and since when
        self._looked = 0.0
        self._counted, self._next_count = Counter[str](), 0.0

    def counted(self) -> Counter[str]:
        """How many lead to each place (`cm.server.client_quotas.Client.place`), counted at most a tenth of the time."""
        began = time.monotonic()
        if began < self._next_count:
            return self._counted
        found = self._counted = Counter[str]()
        for connection in sockets():
            with connection, suppress(OSError):  # a listening one, or one that has just ended
                found[self._place(connection)] += 1
        del found[""]
        self._next_count = time.monotonic() + 10 * (time.monotonic() - began)
        return found

    def _place(self, connection: socket.socket, names: tuple[str, ...] = _TOPICS) -> str:
        """Where one of ours leads; empty for others. Raises OSError."""
        peer, here = connection.getpeername(), connection.getsockname()
        if connection.family == socket.AF_UNIX:
            return place_of(credentials(connection)[0], "") if here in {self._paths[name] for name in names} else ""
        ports = {int(getattr(bound, name).rpartition(":")[2]) for bound in self._tcp for name in names}
        return place_of(None, str(peer[0])) if here[1] in ports else ""

    @staticmethod
    def end(fd: int, whose: str) -> None:
        """End a connection by its descriptor, if it is still that of the client with this id (ZMQ's User-Id)."""
        with suppress(OSError), socket.socket(fileno=os.dup(fd)) as connection:
            if connection.family == socket.AF_UNIX:
                pid, uid, gid = credentials(connection)
                same = of_process(IPC, uid, gid, pid).id == whose
            else:
                same = place_of(None, str(connection.getpeername()[0])) == from_id(whose).address
            if same:
                connection.shutdown(socket.SHUT_RDWR)
                _LOG.warning("a connection of %s was ended: it subscribes to too much", whose)

    def settle(self) -> None:
        """Once a second: end those of the client with the most if they take up a quarter of all descriptors.

        libzmq would take more until there are none, and then end this process (``Too many open files``).
        """
        most = resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 4
        if len(os.listdir("/proc/self/fd")) <= most or self.counted().total() <= most:  # noqa: PTH208
            return  # what else takes descriptors has bounds of its own
        for place, count in self.counted().most_common(1):
            _LOG.warning("%d connections of %s were ended: they take up the descriptors (RLIMIT_NOFILE)", count, place)
            for connection in sockets():
                with connection, suppress(OSError):
                    if self._place(connection) == place:
                        connection.shutdown(socket.SHUT_RDWR)

    def end_stuck(self) -> None:
        """End the connection of the subscriber that has taken nothing for longest; asked again and again."""
        now = time.monotonic()
        if now < self._looked + _LOOK:
            return
        self._looked, before, self._stuck = now, self._stuck, {}
        for connection in sockets():
            with connection, suppress(OSError):
                if place := self._place(connection, ("pub",)):
                    left = int.from_bytes(fcntl.ioctl(connection, _OUTQ, bytes(4)), "little")
                    key = os.fstat(connection.fileno()).st_ino, place
                    then, since = before.get(key, (left, now))
                    if left:
                        self._stuck[key] = left, since if then == left else now
        if self._stuck:
            longest = min(self._stuck, key=lambda key: self._stuck[key][1])
            if now - self._stuck[longest][1] >= _STUCK:
                self._end(longest)

    def _end(self, which: tuple[int, str]) -> None:
        del self._stuck[which]
        for connection in sockets():
            with connection, suppress(OSError):
                if os.fstat(connection.fileno()).st_ino == which[0]:
                    connection.shutdown(socket.SHUT_RDWR)
                    _LOG.warning(
                        "a subscriber of %s was ended: it left frames unread for longest (streams.queue_mib)", which[1]
                    )


_OURS = ("pub", "sub", "req", SOCKET)


class Sessions:
    """The connections of the sockets in a runtime folder and of TCP ports. The loop's thread."""

    def __init__(self, gate: Gate, folder: Path, tcp: list[Endpoints], manager: Manager) -> None:
        """`tcp` grows as ports are bound."""
        self.gate = gate
        self._paths = {str(folder.absolute() / name) for name in _OURS}
        self._tcp = tcp
        self._manager = manager

    def scene(self) -> Scene:
        """What is needed to understand requests, if the client may not do everything."""
        manager, state, running = self._manager, self._manager.state, self._manager.running
        return Scene(
            manager.loaded_config(),
            state.mode,
            lambda r: target(r, manager.configs, state.config),
            state.modules,
            running.number if running else 0,
            running.touches if running else (),
            manager.coming,
        )

    def whose(self, connection: socket.socket) -> str:
        """The client at the other end of a connection to the data socket, as the gate knows it. Raises OSError."""
        pid, uid, gid = credentials(connection)
        return of_process(DATA, uid, gid, pid).id

    def check_open(self, who: str, wanted: Open) -> None:
        """Raise Forbidden if a client of the data socket wants what it has no right to, as the board is now."""
        try:
            self.gate.check(who, *needs_of(OPENING[wanted.purpose], wanted, self.scene()))
        except Forbidden as error:
            self.gate.refused(who, "opening", error)
            raise

    def renew(self, access: Access) -> None:
        """Apply another policy from now on; end sessions whose rights differ under it."""
        self._end(self.gate.renew(access))

    def end_expired(self) -> None:
        """End the sessions of keys that have expired; called now and then."""
        self.gate.audit.flush()
        keys = self.gate.expired()
        if keys:
            self._end(lambda who: who.key in keys)

    def _end(self, meant: Callable[[Principal], bool]) -> None:
        ended = 0
        for connection in sockets():
            with connection, suppress(OSError):  # a listening one, or one that has just ended
                if any(meant(who) for who in self._behind(connection)):
                    connection.shutdown(socket.SHUT_RDWR)
                    ended += 1
        if ended:
            _LOG.warning("rights have changed: %d connections ended", ended)

    def _behind(self, connection: socket.socket) -> Iterable[Principal]:
        """The clients that may be at the other end: over TCP, all that connected from that address. Raises OSError."""
        peer, here = connection.getpeername(), connection.getsockname()
        if connection.family == socket.AF_UNIX:
            pid, uid, gid = credentials(connection) if here in self._paths else (0, -1, 0)
            return () if uid < 0 else (of_process(IPC, uid, gid, pid),)
        ports = {int(end.rpartition(":")[2]) for bound in self._tcp for end in (bound.pub, bound.sub, bound.req)}
        return self.gate.from_address(str(peer[0])) if here[1] in ports else ()
