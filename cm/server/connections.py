# SPDX-License-Identifier: Apache-2.0
"""The connections of this process as the kernel has them: where each leads, and their end.

libzmq has no call that closes one client's connection. But every connection is a descriptor of this process, and the
kernel says where it leads, so those that have to end are shut down beneath libzmq. Honest clients connect again.
"""

from __future__ import annotations

import fcntl
import logging
import os
import resource
import socket
import stat
import struct
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from cm.server.rights.principal import IPC, of_process
from cm.server.shares.clients import place_of
from cm.wire.topics import Endpoints

_LOG = logging.getLogger("cm")
_DESCRIPTORS = 65536  # requested, if as many are allowed: libzmq ends its process when it has none for a connection
_CREDENTIALS = struct.Struct("=iII")  # struct ucred
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


def credentials(connection: socket.socket) -> tuple[int, int, int]:
    """pid, uid, gid of the process that connected. Raises OSError."""
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, gid = _CREDENTIALS.unpack(raw)
    return pid, uid, gid


class Connections:
    """Those over ZeroMQ: of the sockets in a runtime folder, and of TCP ports. The loop's thread."""

    def __init__(self, folder: Path, tcp: list[Endpoints]) -> None:
        """`tcp` grows as ports are bound."""
        self._paths = {name: str(folder.absolute() / name) for name in _TOPICS}
        self._tcp = tcp
        self._stuck: dict[tuple[int, str], tuple[int, float]] = {}  # by inode and peer: bytes, and since when
        self._looked = 0.0

    def counted(self) -> Counter[str]:
        """How many lead to each place (`cm.server.shares.clients.Client.place`)."""
        found = Counter[str]()
        for connection in sockets():
            with connection, suppress(OSError):  # a listening one, or one that has just ended
                found[self._place(connection)] += 1
        del found[""]
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
                same = f":{place_of(None, str(connection.getpeername()[0]))}" in whose
            if same:
                connection.shutdown(socket.SHUT_RDWR)
                _LOG.warning("a connection of %s was ended: it subscribes to too much", whose)

    def settle(self) -> None:
        """Once a second: end those of the client with the most if they take up a quarter of all descriptors.

        libzmq would take more until there are none, and then end this process (``Too many open files``).
        """
        if len(os.listdir("/proc/self/fd")) <= resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 4:  # noqa: PTH208
            return
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
                        "a subscriber of %s was ended: it left frames unread for longest (--stream-queue)", which[1]
                    )
