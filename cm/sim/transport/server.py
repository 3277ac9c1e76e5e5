# SPDX-License-Identifier: Apache-2.0
"""Listening nodes and their connections: the protocol of ``cm_node.h`` without any device in it.

A `Node` opens `Session`s; a session answers requests. Sends never block: a client that does not take
its replies is not read from until it does, and one that does not take its events loses the newest.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import socket

from cm.loop import Loop
from cm.sim.transport import protocol
from cm.sim.transport.connection import NodeConnection
from cm.sim.transport.events import packet_cost
from cm.sim.transport.session import Node

_log = logging.getLogger(__name__)
_REST = 0.1  # seconds


class Server:
    """The listening sockets and the connections of a board."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.cost = packet_cost()
        self.inbox = memoryview(bytearray(protocol.PAYLOAD_MAX + protocol.REQUEST.size))
        self._listeners: dict[socket.socket, Node] = {}
        self._connections: set[NodeConnection] = set()

    @property
    def connections(self) -> int:
        """Open connections, of all nodes."""
        return len(self._connections)

    def listen(self, listener: socket.socket, node: Node) -> None:
        """Serve `node` at a bound, listening socket, which the server owns from now on."""
        listener.setblocking(False)
        self._listeners[listener] = node
        self.loop.add(listener.fileno(), lambda: self._accept(listener), listener=True)

    def connect(self, node: Node) -> socket.socket:
        """The client's end of a new connection to `node`, which the caller owns and hands over."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._connections.add(NodeConnection(self, ours, node))
        return theirs

    def unlisten(self, listener: socket.socket) -> None:
        """Stop listening; open connections stay."""
        if self._listeners.pop(listener, None) is not None:
            self.loop.remove(listener.fileno())
            listener.close()

    def forget(self, connection: NodeConnection) -> None:
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
