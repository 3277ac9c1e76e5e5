# SPDX-License-Identifier: Apache-2.0
"""Listening nodes and their connections: the protocol of ``cm_node.h`` without any device in it.

A `Node` opens `Session`s; a session answers requests. A request may be answered later through
`Later`. Sends never block: a client that does not take its replies is not read from until it
does, and one that does not take its events loses the newest.
"""

from __future__ import annotations

import array
import contextlib
import errno
import fcntl
import logging
import os
import socket
import struct
from collections.abc import Callable, Sequence
from typing import Protocol

from . import protocol
from .errors import NodeError
from .loop import Loop

SIOCOUTQ = 0x5411  # bytes sent and not yet read, linux/sockios.h
_FDS_MAX = 4
_log = logging.getLogger(__name__)
_ANCILLARY = socket.CMSG_LEN(_FDS_MAX * 4)
_REST = 0.1  # seconds
_CLOEXEC = int(socket.MSG_CMSG_CLOEXEC)
_CUT = int(socket.MSG_TRUNC | socket.MSG_CTRUNC)


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


class Session(Protocol):
    """One open file of a node."""

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Answer | Later:
        """Answer a request or raise `NodeError`. `fds` are closed by the caller."""

    def write(self, data: bytes) -> None:
        """The client wrote to the event socket."""

    def close(self) -> None:
        """The client has gone: release what it held."""


class Node(Protocol):
    """What listens at a path."""

    def open(self, events: Events) -> Session:
        """A client connects; raise `NodeError` to make its open() fail."""


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


class Connection:
    """One client of one node."""

    def __init__(self, server: Server, sock: socket.socket, node: Node) -> None:
        self._server = server
        self._loop = server.loop
        self._sock = sock
        self._unsent: tuple[bytes, Sequence[int]] | None = None
        self._events: socket.socket | None = None
        self._session: Session | None = None
        self._open(node)

    def close(self) -> None:
        """End the connection and release what its session held; harmless twice."""
        if self._sock.fileno() < 0:
            return
        self._close_events()
        self._loop.remove(self._sock.fileno())
        self._sock.close()
        if self._unsent is not None:
            _close_all(self._unsent[1])
        if self._session is not None:
            self._session.close()
        self._server.forget(self)

    def _open(self, node: Node) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._loop.add(self._sock.fileno(), self._readable)
        try:
            self._session = node.open(Events(ours, self._server.cost))
        except NodeError as error:
            self._reply(protocol.OP_OPEN, error.number)
            ours.close()
            theirs.close()
            self.close()
            return
        self._events = ours
        self._loop.add(ours.fileno(), self._event_readable)
        self._reply(protocol.OP_OPEN, 0, b"", [theirs.detach()])

    def _readable(self) -> None:
        """Serve one request: more of them make the descriptor ready again, after others had their turn."""
        try:
            length, ancillary, flags, _ = self._sock.recvmsg_into([self._server.inbox], _ANCILLARY, _CLOEXEC)
        except BlockingIOError:
            return
        except OSError:
            length, ancillary, flags = 0, [], 0
        if not length:
            self.close()
            return
        fds = _received(ancillary) if ancillary else []
        try:
            self._request(bytes(self._server.inbox[:length]), flags, fds)
        finally:
            if fds:
                _close_all(fds)

    def _request(self, data: bytes, flags: int, fds: Sequence[int]) -> None:
        if len(data) < protocol.REQUEST.size:
            self._reply(0, errno.EPROTO)
            return
        op, length = protocol.REQUEST.unpack_from(data)
        if flags & _CUT or length != len(data) - protocol.REQUEST.size:
            self._reply(op, errno.EMSGSIZE)
            return
        assert self._session is not None
        try:
            answer = self._session.request(op, data[protocol.REQUEST.size :], fds)
        except NodeError as error:
            self._reply(op, error.number)
        except Exception:  # noqa: BLE001 - one client's request must not end the board
            _log.exception("request %#x failed", op)
            self._reply(op, errno.EIO)
        else:
            self._answer(op, answer)

    def _answer(self, op: int, answer: bytes | Answer | Later) -> None:
        if isinstance(answer, bytes):
            self._reply(op, 0, answer)
        elif isinstance(answer, Answer):
            self._reply(op, 0, answer.payload, answer.fds)
        else:
            self._loop.pause(self._sock.fileno())
            answer.then(lambda result: self._finish(op, result))

    def _finish(self, op: int, result: bytes | NodeError) -> None:
        if self._sock.fileno() < 0:
            return
        self._loop.resume(self._sock.fileno())
        if isinstance(result, NodeError):
            self._reply(op, result.number)
        else:
            self._reply(op, 0, result)

    def _reply(self, op: int, error: int, payload: bytes = b"", fds: Sequence[int] = ()) -> None:
        if self._sock.fileno() < 0:
            _close_all(fds)
            return
        self._unsent = (protocol.REPLY.pack(op, error, len(payload), 0) + payload, fds)
        self._flush()

    def _flush(self) -> None:
        if self._unsent is None:
            return
        data, fds = self._unsent
        try:
            if fds:
                socket.send_fds(self._sock, [data], list(fds))
            else:
                self._sock.send(data)
        except BlockingIOError:
            self._loop.watch_write(self._sock.fileno(), self._writable)
            return
        except OSError:
            self._loop.soon(self.close)
        _close_all(fds)
        self._unsent = None

    def _writable(self) -> None:
        self._loop.watch_write(self._sock.fileno(), None)
        self._flush()

    def _event_readable(self) -> None:
        if self._events is None:
            return
        try:
            data = self._events.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._close_events()
        elif self._session is not None:
            with contextlib.suppress(NodeError):
                self._session.write(data)

    def _close_events(self) -> None:
        if self._events is not None:
            self._loop.remove(self._events.fileno())
            self._events.close()
            self._events = None


class Server:
    """The listening sockets and the connections of a board."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.cost = packet_cost()
        self.inbox = memoryview(bytearray(protocol.PAYLOAD_MAX + protocol.REQUEST.size))
        self._listeners: dict[socket.socket, Node] = {}
        self._connections: set[Connection] = set()

    @property
    def connections(self) -> int:
        """Open connections, of all nodes."""
        return len(self._connections)

    def listen(self, listener: socket.socket, node: Node) -> None:
        """Serve `node` at a bound, listening socket, which the server owns from now on."""
        listener.setblocking(False)
        self._listeners[listener] = node
        self.loop.add(listener.fileno(), lambda: self._accept(listener), listener=True)

    def unlisten(self, listener: socket.socket) -> None:
        """Stop listening; open connections stay."""
        if self._listeners.pop(listener, None) is not None:
            self.loop.remove(listener.fileno())
            listener.close()

    def forget(self, connection: Connection) -> None:
        """A connection has ended."""
        self._connections.discard(connection)

    def close(self) -> None:
        """End everything."""
        for listener in list(self._listeners):
            self.unlisten(listener)
        for connection in list(self._connections):
            connection.close()

    def _accept(self, listener: socket.socket) -> None:
        # One at a time: what closed before this client connected has been served by now.
        try:
            sock, _ = listener.accept()
        except BlockingIOError:
            return
        except OSError as error:
            self._rest(listener, error)
            return
        sock.setblocking(False)
        try:
            connection = Connection(self, sock, self._listeners[listener])
        except OSError as error:
            with contextlib.suppress(OSError):
                sock.send(protocol.REPLY.pack(protocol.OP_OPEN, error.errno or errno.EMFILE, 0, 0))
            sock.close()
            self._rest(listener, error)
            return
        if sock.fileno() >= 0:
            self._connections.add(connection)

    def _rest(self, listener: socket.socket, error: OSError) -> None:
        """Out of descriptors or memory: the client waits, and we do not spin."""
        _log.warning("a client could not be served at once: %s", error)
        self.loop.pause(listener.fileno())
        self.loop.after(_REST, lambda: self._resume(listener))

    def _resume(self, listener: socket.socket) -> None:
        if listener in self._listeners:
            self.loop.resume(listener.fileno())


def _received(ancillary: Sequence[tuple[int, int, bytes]]) -> list[int]:
    fds = array.array("i")
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            fds.frombytes(data[: len(data) - len(data) % fds.itemsize])
    return list(fds)


def _close_all(fds: Sequence[int]) -> None:
    for fd in fds:
        with contextlib.suppress(OSError):
            os.close(fd)
