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
from cm.server.client_process import credentials
from cm.server.client_quotas import place_of
from cm.server.rights.admission import Gate
from cm.server.rights.model import Access
from cm.server.rights.principal import DATA, IPC, Principal, from_id, of_process
from cm.server.rights.required_rights import OPENING, needs_of
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
    """Those of the sockets in a runtime folder, and of TCP ports. The loop's thread."""

    def __init__(self, gate: Gate, folder: Path, tcp: list[Endpoints]) -> None:
        """`tcp` grows as ports are bound."""
        self.gate = gate
        self._paths = {name: str(folder.absolute() / name) for name in (*_TOPICS, SOCKET)}
        self._tcp = tcp
        self._manager: Manager
        self._stuck: dict[tuple[int, str], tuple[int, float]] = {}  # by inode and peer: bytes, and since when
        self._looked = 0.0
        self._counted, self._next_count = Counter[str](), 0.0

    def begin(self, manager: Manager) -> None:
        """Ask this manager what requests are about, from before the first one."""
        self._manager = manager

    # ---- what they may ----------------------------------------------------------------------

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
        """Apply another policy from now on; end connections whose rights differ under it."""
        self._end_of(self.gate.renew(access))

    def end_expired(self) -> None:
        """End the connections of keys that have expired; called now and then."""
        self.gate.audit.flush()
        keys = self.gate.expired()
        if keys:
            self._end_of(lambda who: who.key in keys)

    def _end_of(self, meant: Callable[[Principal], bool]) -> None:
        ended = _end_those(lambda connection: any(meant(who) for who in self._behind(connection)))
        if ended:
            _LOG.warning("rights have changed: %d connections ended", ended)

    # ---- where they lead --------------------------------------------------------------------

    def _behind(self, connection: socket.socket) -> Iterable[Principal]:
        """The clients that may be at the other end: over TCP, all that connected from that address. Raises OSError."""
        peer = connection.getpeername()
        if not self._is_of(connection, (*_TOPICS, SOCKET)):
            return ()
        if connection.family == socket.AF_UNIX:
            pid, uid, gid = credentials(connection)
            return (of_process(IPC, uid, gid, pid),)
        return self.gate.from_address(str(peer[0]))

    def _place(self, connection: socket.socket, names: tuple[str, ...] = _TOPICS) -> str:
        """Where one over ZeroMQ leads (`cm.server.client_quotas.Client.place`); empty for others. Raises OSError."""
        peer = connection.getpeername()
        if not self._is_of(connection, names):
            return ""
        is_local = connection.family == socket.AF_UNIX
        return place_of(credentials(connection)[0], "") if is_local else place_of(None, str(peer[0]))

    def _is_of(self, connection: socket.socket, names: Iterable[str]) -> bool:
        """Whether it is one of these sockets'. Raises OSError."""
        here = connection.getsockname()
        if connection.family == socket.AF_UNIX:
            return here in [self._paths[name] for name in names]
        ends = (getattr(bound, name) for bound in self._tcp for name in names if name in _TOPICS)
        return here[1] in {int(end.rpartition(":")[2]) for end in ends}

    def counted(self) -> Counter[str]:
        """How many over ZeroMQ lead to each place, counted at most a tenth of the time."""
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

    # ---- the end of those that take too much ------------------------------------------------

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
            _end_those(lambda connection, place=place: self._place(connection) == place)  # type: ignore[misc]

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
        longest = min(self._stuck, key=lambda key: self._stuck[key][1], default=None)
        if longest is not None and now - self._stuck[longest][1] >= _STUCK:
            del self._stuck[longest]
            if _end_those(lambda connection: os.fstat(connection.fileno()).st_ino == longest[0]):
                said = "a subscriber of %s was ended: it left frames unread for longest (streams.queue_mib)"
                _LOG.warning(said, longest[1])


def _end_those(which: Callable[[socket.socket], bool]) -> int:
    """Shut down the sockets of this process for which this is true, and return how many there were."""
    ended = 0
    for connection in sockets():
        with connection, suppress(OSError):  # a listening one, or one that has just ended
            if which(connection):
                connection.shutdown(socket.SHUT_RDWR)
                ended += 1
    return ended
