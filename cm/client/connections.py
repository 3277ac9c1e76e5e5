# SPDX-License-Identifier: Apache-2.0
"""A client's connections over ZeroMQ: how they are made, made again when they were lost, and end together."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterator, Sized
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

import zmq

from cm.client.after_fork import not_for_children
from cm.client.core.connection_monitor import EVENTS, Handshake
from cm.client.errors import BoardClosed, NotAdmitted
from cm.client.find_manager import Keys
from cm.wire.topics import Endpoints

Socket = zmq.Socket[bytes]
_Socket = TypeVar("_Socket", bound="zmq.Socket[Any]")
_User = TypeVar("_User", bound="User")
# Milliseconds until ZeroMQ tries to connect again, which are 100 unless set. Over ipc it costs little, and ZeroMQ does
# not wait for a place in a full queue: where others connect without end, there is one now and then only.
_RECONNECT_MS = 10
_LONGEST = (1 << 30) + (1 << 20)  # bytes of a part of a message: no frame of a stream is longer than 1 GiB
_FEW = 8  # reads of a register before there is a connection for them: who reads once needs none
_LEAVES = 5.0  # seconds at most until a thread that was sent out of its socket has left it


def prepare(socket: _Socket, keys: Keys | None, depth: int = 0) -> _Socket:
    """Options that every client socket has, before it connects; `depth` messages wait (0: ZeroMQ's own number)."""
    if depth:
        socket.setsockopt(zmq.RCVHWM, depth)  # not to be set later: see cm/server/publisher.py
    socket.setsockopt(zmq.LINGER, 0)  # close() must not wait for a manager that has gone
    socket.setsockopt(zmq.IPV6, 1)
    socket.setsockopt(
        zmq.MAXMSGSIZE, _LONGEST
    )  # libzmq makes room for what is announced, or hangs for ever where it cannot
    if keys is not None:
        socket.curve_serverkey = keys.server_public
        socket.curve_publickey = keys.public
        socket.curve_secretkey = keys.secret
    return socket


class User(Protocol):
    """Has sockets of its own; threads may wait in it."""

    def end(self, because: BoardClosed) -> None:
        """Close them: whoever waits there, or comes later, raises `because`."""


class Living:
    """Things for as long as they live. One thread may add one while another goes through them."""

    def __init__(self) -> None:
        self._refs: set[weakref.ref[Any]] = set()

    def add(self, thing: Any) -> None:
        """From now on, until it is garbage."""
        self._refs.add(weakref.ref(thing, self._refs.discard))

    def __iter__(self) -> Iterator[Any]:
        """Those that are there now."""
        for ref in self._refs.copy():  # a WeakSet raises RuntimeError if another thread adds something
            thing = ref()
            if thing is not None:
                yield thing


class Sockets:
    """Makes sockets, and holds them until they are closed.

    A context waits for its sockets when it ends. If left to the garbage collector, it may end before them and wait
    for ever, since it does not know sockets that are garbage themselves. So the owner of this arranges that `close`
    is called when it is collected (`weakref.finalize`), and the sockets held here are not garbage.
    """

    def __init__(self, context: zmq.Context[Any], endpoints: Endpoints, keys: Keys | None) -> None:
        self.endpoints = endpoints
        self._context = context
        self._keys = keys
        self._open: set[Any] = set()
        self._turns = Living()
        self._users = Living()
        self.closed = False  # the board; or it belongs to the process that this one was forked from
        self._disowned = False
        self._ending: threading.Thread | None = None
        self.closing: AbstractContextManager[Any] = (
            threading.RLock()
        )  # for one thread at a time, and again for a signal handler in it
        not_for_children(self)

    def disown(self) -> None:
        """This process was forked: all is the parent's, and locks that its other threads held will never be free."""
        self.closed = self._disowned = True
        self.closing = threading.RLock()
        self.end_users()

    def gone(self) -> BoardClosed:
        """The error for any use from now on."""
        return (inherited if self._disowned else closed)(self.endpoints.req)

    @contextmanager
    def ending(self) -> Iterator[None]:
        """What another thread's `close` breaks off raises BoardClosed."""
        try:
            yield
        except zmq.ZMQError:
            if not self.closed:
                raise
            raise self.gone() from None

    def end_users(self) -> None:
        """End what uses the data socket; any later use of it raises `gone`."""
        for user in self._users:
            user.end(self.gone())

    def turn(self) -> Any:
        """A lock to be held by a thread that uses sockets, so that `free` knows of it."""
        turn = threading.RLock()  # the thread itself may close, in a signal handler
        self._turns.add(turn)
        return turn

    def using(self, user: _User) -> _User:
        """Note who uses the manager's data socket, and ends with the board. Raises BoardClosed."""
        self._users.add(user)
        if self.closed:  # looked at last: a `refuse` that did not find the user has said so before
            user.end(self.gone())
            raise self.gone()
        return user

    def refuse(self) -> None:
        """End all users of the data socket; whoever asks for any socket from here on gets BoardClosed."""
        self.closed = True
        self.end_users()

    def free(self) -> None:
        """Send all other threads out of their sockets, at once, by zmq.ContextTerminated (zmq_ctx_term(3)).

        What is left to do is to close.
        """
        self.closed = True  # who gets a turn from here on sees that
        if self._disowned:
            return
        with self.closing:
            waiting = [turn for turn in self._turns if not _left(turn, 0.0)]
            if waiting and self._ending is None and not self._context.closed:
                self._ending = threading.Thread(target=self._context.term, name="end of a board", daemon=True)
                self._ending.start()  # it waits until the last socket is closed
            for turn in waiting:
                _left(turn, _LEAVES)

    def requests(self, immediate: bool = False) -> Any:
        """A DEALER for requests, its monitor, and the handshake, which says if the manager has gone or refuses us.

        `immediate`: what could not be sent before a connection ended is dropped with it, and never reaches the next
        manager there. Raises BoardClosed.
        """
        with self.ending():
            socket = self._new(zmq.DEALER)
            socket.setsockopt(zmq.IMMEDIATE, int(immediate))
            # The loss of a peer must be noticed at once on ipc, and within seconds over a dead network.
            socket.setsockopt(zmq.HEARTBEAT_IVL, 2000)
            socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 6000)
            monitor = socket.get_monitor_socket(EVENTS)
            self._open.add(monitor)
            socket.connect(self.endpoints.req)
        return socket, monitor, Handshake(self.endpoints.req, self._keys is not None)

    def subscriber(self, topics: tuple[bytes, ...], depth: int = 0) -> Any:
        """A SUB socket on topics, on which `depth` messages wait (0: ZeroMQ's own number), and its monitor.

        The monitor is readable once the manager refuses our subscription. Raises BoardClosed.
        """
        with self.ending():
            socket = self._new(zmq.SUB, depth)
            monitor = socket.get_monitor_socket(zmq.EVENT_HANDSHAKE_FAILED_AUTH)
            self._open.add(monitor)
            for topic in topics:
                socket.setsockopt(zmq.SUBSCRIBE, topic)
            socket.connect(self.endpoints.pub)
        return socket, monitor

    def _new(self, kind: int, depth: int = 0) -> Any:
        if self.closed:
            raise self.gone()
        socket = prepare(self._context.socket(kind), self._keys, depth)
        if self.endpoints.req.startswith("ipc:"):
            socket.setsockopt(zmq.RECONNECT_IVL, _RECONNECT_MS)
        self._open.add(socket)
        return socket

    def hang_up(self, socket: Any, monitor: Any) -> None:
        """Close a socket and its monitor; twice is fine."""
        if self._disowned:
            return
        with suppress(zmq.ZMQError):  # the board is being closed by another thread; pyzmq 24's `closed` raises then
            if not socket.closed:
                socket.disable_monitor()
        self.end(monitor, socket)

    def end(self, *sockets: Any) -> None:
        """Close sockets before the rest; twice is fine."""
        for socket in sockets:
            self._open.discard(socket)
            socket.close(0)

    def close(self) -> None:
        """Close all; twice is fine."""
        self.closed = True
        if self._disowned:
            return
        with self.closing:
            self.end(*self._open)
            if self._ending is None:
                self._context.destroy(linger=0)
            else:
                with suppress(RuntimeError):  # not started yet, below this signal handler: it will find all closed
                    self._ending.join(_LEAVES)


class ByName:
    """Reads of registers by name: `read` gives the value if it needs no request, else None.

    The first are requests; those after them need none where the data socket gives an answer (`LocalReads`).
    """

    def __init__(self, sockets: Sockets, folder: Path | None, unanswered: Sized, patience: float) -> None:
        """`folder`: of the data socket, if there is one; the others are those of `LocalReads`."""
        self._sockets, self._folder, self._with = sockets, folder, (unanswered, patience)
        self._asked = 0
        self.read: Callable[[str], int | None] = self._ask

    def _ask(self, _: str) -> None:
        self._asked += 1
        if self._asked > _FEW and self._folder is not None:
            from cm.client.local_reads import LocalReads  # here: other systems than Linux have no such sockets

            self.read = self._sockets.using(LocalReads(self._folder, *self._with)).read


def _left(turn: Any, seconds: float) -> bool:
    """Whether no other thread has the turn, or none within `seconds`."""
    free: bool = turn.acquire(timeout=seconds)
    if free:
        turn.release()
    return free


def not_subscribed(address: str) -> NotAdmitted:
    """The error if the manager does not let us subscribe."""
    return NotAdmitted(
        f"the manager at {address} refuses subscriptions, which need the right to observe everything; "
        "request what is allowed instead"
    )


def closed(address: str) -> BoardClosed:
    """The error for any use of a board after it was closed."""
    return BoardClosed(f"the board at {address} was closed: connect() again")


def inherited(address: str) -> BoardClosed:
    """The error for any use of a board in a child process of the one that connected."""
    return BoardClosed(f"the board at {address} belongs to the process that this one was forked from: connect() here")
