# SPDX-License-Identifier: Apache-2.0
"""What a node offers to the server: sessions, answers that come later or bring descriptors, and events."""

from __future__ import annotations

import errno
import fcntl
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from cm.simulation.software.errors import NodeError
from cm.simulation.software.transport import protocol

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


class Later:
    """The answer to a request that takes time: call `finish` once, whenever it is known."""

    def __init__(self) -> None:
        self._callback: Callable[[bytes | NodeError], None] | None = None
        self._result: bytes | NodeError | None = None

    def finish(self, result: bytes | NodeError = b"") -> None:
        """Answer with a payload, or with an error."""
        self._result = result
        if self._callback is not None:
            self._callback(result)

    def then(self, callback: Callable[[bytes | NodeError], None]) -> None:
        """Have `callback` called with the result, at once if there is one."""
        self._callback = callback
        if self._result is not None:
            callback(self._result)


class Answer:
    """A payload with descriptors; the connection closes them when they are sent."""

    __slots__ = ("fds", "payload")

    def __init__(self, payload: bytes, fds: Sequence[int] = ()) -> None:
        self.payload = payload
        self.fds = fds


class Opened:
    """A session, and what its greeting offers (``CM_NODE_OFFERS_*``)."""

    __slots__ = ("offers", "session")

    def __init__(self, session: Session, offers: int) -> None:
        self.session = session
        self.offers = offers


class Session:
    """One open file of a node."""

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Answer | Later:
        """Answer a request or raise `NodeError`. `fds` are closed by the caller."""
        raise NotImplementedError

    def write(self, data: bytes) -> None:
        """The client wrote to the event socket: nothing by default."""

    def close(self) -> None:
        """The client has gone: release what it held."""


class Attribute(Session):
    """A node that keeps nothing for its open files and has no events: it is its own session, of every client."""


class Ioctls(Session):
    """A file whose requests are ioctls: handlers by number, without the size in it.

    A caller may know a shorter or longer structure.
    """

    def __init__(self, handlers: Mapping[int, Callable[[bytes], bytes | Answer]]) -> None:
        self._handlers = {number & 0xFFFF: handler for number, handler in handlers.items()}
        self.fds: Sequence[int] = ()  # of the request that is answered

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Answer:
        """Answer one."""
        self.fds = fds
        handler = self._handlers.get(op & 0xFFFF)
        if handler is None:
            raise NodeError(errno.ENOTTY, "no such ioctl")
        return handler(payload)


class Node(Protocol):
    """What listens at a path."""

    def open(self, events: Events) -> Session | Opened:
        """A client connects; raise `NodeError` to make its open() fail."""
