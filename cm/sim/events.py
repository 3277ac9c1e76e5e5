# SPDX-License-Identifier: Apache-2.0
"""Our end of a connection's event socket."""

from __future__ import annotations

import fcntl
import socket
import struct

from . import protocol

SIOCOUTQ = 0x5411  # bytes sent and not yet read, linux/sockios.h


class Events:
    """Our end of a connection's event socket."""

    def __init__(self, end: socket.socket, cost: int) -> None:
        self._socket = end
        self._cost = cost
        self.sent = 0

    def send(self, packet: bytes) -> bool:
        """Send one packet; False where the client's queue is full or it has gone."""
        try:
            self._socket.send(packet)
        except OSError:
            return False
        self.sent += 1
        return True

    def unread(self) -> int:
        """Packets sent and not yet read by the client, where they are about 48 bytes long."""
        try:
            return _queued(self._socket) // self._cost
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
