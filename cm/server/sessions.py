# SPDX-License-Identifier: Apache-2.0
"""Open connections, and their end when the policy changes: those whose rights differ are closed.

Honest clients connect again, and get their present rights.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from cm.errors import Forbidden
from cm.manager.manager import Manager
from cm.manager.planning.goals import target
from cm.server.connections import credentials, sockets
from cm.server.rights.gate import Gate
from cm.server.rights.model import Access
from cm.server.rights.needs import Scene, opening
from cm.server.rights.principal import DATA, IPC, Principal, of_process
from cm.wire.plane_packets import SOCKET, Open
from cm.wire.topics import Endpoints

_LOG = logging.getLogger("cm")
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
        manager, state = self._manager, self._manager.state
        return Scene(manager.loaded_config(), state.mode, lambda r: target(r, manager.configs, state.config))

    def whose(self, connection: socket.socket) -> str:
        """The client at the other end of a connection to the data socket, as the gate knows it. Raises OSError."""
        pid, uid, gid = credentials(connection)
        return of_process(DATA, uid, gid, pid).id

    def check_open(self, connection: socket.socket, wanted: Open) -> None:
        """Raise Forbidden if a connection to the data socket requests something that it has no right to."""
        who, writes = self.whose(connection), wanted.write or wanted.allocate
        try:
            self.gate.check(who, opening(wanted.name, writes, self.scene()))
        except Forbidden as error:
            self.gate.refused(who, "opening", error)
            raise

    def renew(self, access: Access) -> None:
        """Apply another policy from now on; end sessions whose rights differ under it."""
        self._end(self.gate.renew(access))

    def look(self) -> None:
        """End the sessions of keys that have expired; called now and then."""
        self.gate.audit.look()
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
