# SPDX-License-Identifier: Apache-2.0
"""Listening nodes and their connections: the protocol of ``cm_node.h`` without any device in it.

A `Node` opens `Session`s; a session answers requests. Sends never block: a client that does not take
its replies is not read from until it does, and one that does not take its events loses the newest.
"""

from __future__ import annotations

import array
import contextlib
import errno
import logging
import os
import socket
from collections.abc import Callable, Sequence

from cm.loop import Loop
from cm.simulation.software.errors import NodeError
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.session import (
    Answer,
    Attribute,
    Events,
    Later,
    Node,
    Opened,
    Session,
    packet_cost,
)

_log = logging.getLogger(__name__)
_FDS_MAX = 4
_ANCILLARY = socket.CMSG_LEN(_FDS_MAX * 4)
_CLOEXEC = int(socket.MSG_CMSG_CLOEXEC)
_CUT = int(socket.MSG_TRUNC | socket.MSG_CTRUNC)


class NodeConnection:
    """One client of one node."""

    def __init__(self, host: Server, sock: socket.socket, node: Node | Attribute) -> None:
        self._host = host
        self._loop = host.loop
        self._sock = sock
        self._unsent: tuple[bytes, Sequence[int]] | None = None
        self._events: socket.socket | None = None
        self._session: Session | None = None
        self._take_back: Callable[[], None] | None = None
        self._open(node)

    def close(self) -> None:
        """End the connection and release what its session held; harmless twice."""
        if self._sock.fileno() < 0:
            return
        self._recover()
        self._close_events()
        self._loop.remove(self._sock.fileno())
        self._sock.close()
        if self._unsent is not None:
            _close_all(self._unsent[1])
        if self._session is not None:
            self._session.close()
        self._host.forget(self)

    @property
    def lendable(self) -> bool:
        """Whether it is open, and nothing waits to be sent."""
        return self._take_back is None and self._events is not None and self._unsent is None

    def lend(self, take_back: Callable[[], None]) -> tuple[int, int]:
        """Serve nothing until `take_back` (called before we do anything); returns descriptors: requests, events."""
        assert self._events is not None
        self._take_back = take_back
        self._loop.pause(self._sock.fileno())
        return self._sock.fileno(), self._events.fileno()

    def returned(self, op: int, owed: bytes | None) -> None:
        """Serve it again; `owed` is the payload of a reply that was not sent yet."""
        self._take_back = None
        self._loop.resume(self._sock.fileno())
        if owed is not None:
            self._reply(op, 0, owed)

    def _recover(self) -> None:
        if self._take_back is not None:
            self._take_back()

    def _open(self, node: Node | Attribute) -> None:
        if isinstance(node, Attribute):
            self._session = node
            self._loop.add(self._sock.fileno(), self._readable)
            self._reply(protocol.OP_OPEN, 0)
            return
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._loop.add(self._sock.fileno(), self._readable)
        try:
            opened = node.open(Events(ours, self._host.cost, self))
        except NodeError as error:
            self._reply(protocol.OP_OPEN, error.number)
            ours.close()
            theirs.close()
            self.close()
            return
        offers = opened.offers if isinstance(opened, Opened) else 0
        self._session = opened.session if isinstance(opened, Opened) else opened
        self._events = ours
        self._loop.add(ours.fileno(), self._event_readable)
        self._reply(protocol.OP_OPEN, 0, b"", [theirs.detach()], offers)

    def _readable(self) -> None:
        """Serve one request: more of them make the descriptor ready again, after others had their turn."""
        self._recover()
        try:
            length, ancillary, flags, _ = self._sock.recvmsg_into([self._host.inbox], _ANCILLARY, _CLOEXEC)
        except BlockingIOError:
            return
        except OSError:
            length, ancillary, flags = 0, [], 0
        if not length:
            self.close()
            return
        fds = _received(ancillary) if ancillary else []
        try:
            self._request(bytes(self._host.inbox[:length]), flags, fds)
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
            self._reply(op, error.number, str(error.strerror).encode() if error.said else b"")
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

    def _reply(self, op: int, error: int, payload: bytes = b"", fds: Sequence[int] = (), flags: int = 0) -> None:
        if self._sock.fileno() < 0:
            _close_all(fds)
            return
        self._unsent = (protocol.REPLY.pack(op, error, len(payload), flags) + payload, fds)
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
            self._loop.call_soon(self.close)
        _close_all(fds)
        self._unsent = None

    def _writable(self) -> None:
        self._loop.watch_write(self._sock.fileno(), None)
        self._flush()

    def _event_readable(self) -> None:
        self._recover()
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


_log = logging.getLogger(__name__)
_REST = 0.1  # seconds


class Server:
    """The listening sockets and the connections of a board."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.cost = packet_cost()
        self.inbox = memoryview(bytearray(protocol.PAYLOAD_MAX + protocol.REQUEST.size))
        self._listeners: dict[socket.socket, Node | Attribute] = {}
        self._connections: set[NodeConnection] = set()

    @property
    def connections(self) -> int:
        """Open connections, of all nodes."""
        return len(self._connections)

    def listen(self, listener: socket.socket, node: Node | Attribute) -> None:
        """Serve `node` at a bound, listening socket, which the server owns from now on; in place of one before it."""
        known = listener in self._listeners
        self._listeners[listener] = node
        if not known:
            listener.setblocking(False)
            self.loop.add(listener.fileno(), lambda: self._accept(listener), listener=True)

    def connect(self, node: Node) -> socket.socket:
        """The client's end of a new connection to `node`, which the caller owns and hands over."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._connections.add(NodeConnection(self, ours, node))
        return theirs

    def forget(self, connection: NodeConnection) -> None:
        """A connection has ended."""
        self._connections.discard(connection)

    def close(self) -> None:
        """End everything."""
        for listener in list(self._listeners):
            self.loop.remove(listener.fileno())
            listener.close()
        self._listeners.clear()
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
            connection = NodeConnection(self, sock, self._listeners[listener])
        except OSError as error:
            with contextlib.suppress(OSError):
                sock.send(protocol.REPLY.pack(protocol.OP_OPEN, error.errno or errno.EMFILE, 0, 0))
            sock.close()
            self._rest(listener, error)
            return
        if sock.fileno() >= 0:
            self._connections.add(connection)

    def _rest(self, listener: socket.socket, error: OSError) -> None:
        """Out of descriptors or memory: let the client wait, without a busy loop."""
        _log.warning("a client could not be served at once: %s", error)
        self.loop.pause(listener.fileno())
        self.loop.call_later(_REST, lambda: self._resume(listener))

    def _resume(self, listener: socket.socket) -> None:
        if listener in self._listeners:
            self.loop.resume(listener.fileno())
