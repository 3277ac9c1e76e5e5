# SPDX-License-Identifier: Apache-2.0
"""Our end of a connection's event socket."""

from __future__ import annotations

import fcntl
import socket
import struct
from collections.abc import Callable
from typing import Protocol

from cm.sim.transport import protocol

SIOCOUTQ = 0x5411  # bytes sent and not yet read, linux/sockios.h


class Line(Protocol):
    """A connection that may be lent to another server for a while."""

    @property
    def lendable(self) -> bool:
        """Whether it is open, and nothing waits to be sent."""

    def lend(self, take_back: Callable[[], None]) -> tuple[int, int]:
        """Serve nothing until `take_back` (called before we do anything); returns descriptors: requests, events."""

    def returned(self, op: int, owed: bytes | None) -> None:
        """Serve it again; `owed` is the payload of a reply that was not sent yet."""


class Events:
    """Our end of a connection's event socket."""

    def __init__(self, end: socket.socket, cost: int, line: Line | None = None) -> None:
        self._socket = end
        self.cost = cost  # of a packet, in the socket's send queue
        self.line = line
        self.sent = 0

    def send(self, packet: bytes) -> bool:
        """Send one packet; False if the client's queue is full or it has gone."""
        try:
            self._socket.send(packet)
        except OSError:
            return False
        self.sent += 1
        return True

    def unread(self) -> int:
        """Packets sent and not yet read by the client, if they are about 48 bytes long."""
        try:
            return _queued(self._socket) // self.cost
        except (OSError, ValueError):
            return 0


def packet_cost() -> int:
    """What one small packet counts in a socket's send queue."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        ours.send(bytes(protocol.DMA_COMPLETION.size))
        return max(1, _queued(ours))


def _queued(sock: socket.socket) -> int:
    return int(struct.unpack("i", fcntl.ioctl(sock.fileno(), SIOCOUTQ, b"\0\0\0\0"))[0])
