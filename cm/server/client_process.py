# SPDX-License-Identifier: Apache-2.0
"""The process at the other end of a client's socket."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path

from cm.frozen import dataclass

_CREDENTIALS = struct.Struct("=iII")  # struct ucred


def credentials(connection: socket.socket) -> tuple[int, int, int]:
    """pid, uid, gid of the process that connected. Raises OSError."""
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, gid = _CREDENTIALS.unpack(raw)
    return pid, uid, gid


@dataclass(frozen=True, slots=True)
class Peer:
    """A process, with the name that the kernel has for it, and its user, whose processes share what one may have."""

    pid: int
    name: str
    uid: int

    @staticmethod
    def of(connection: socket.socket) -> Peer:
        """Return the process that made a connection, with its present name."""
        pid, uid, _ = credentials(connection)
        try:
            return Peer(pid, Path(f"/proc/{pid}/comm").read_text(encoding="utf-8", errors="replace").strip(), uid)
        except OSError:  # it has gone, or is in another PID namespace (pid 0)
            return Peer(pid, "", uid)

    @staticmethod
    def ourselves() -> Peer:
        """The daemon's own clients, for ZeroMQ."""
        return Peer(os.getpid(), "cm (ZeroMQ)", os.geteuid())
