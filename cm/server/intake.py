# SPDX-License-Identifier: Apache-2.0
"""Messages from ZeroMQ sockets, each served in its turn: by what its client has used, not by how often it asks.

A ROUTER or SUB hands out one message of each connection in turn, no matter which client the connections belong to: a
client with 256 connections would get 256 turns. So messages are read ahead, one round over all connections that have
some, and wait here.

A client that sends ahead gains nothing by it: after a round that brought nothing new, there is no other for a while, as
long as each waiting client has a message here.

A client that does not read its answers gets no more of them: its requests wait here until there is room for answers
again. If many bytes of a client wait here, its connections are not read until few do; the rest waits in its own
sockets.

What takes long is served in slices: after each, its client waits for its next turn, and whatever the same sender has
asked for since waits behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from functools import partial
from time import monotonic_ns
from typing import Any, Protocol

import zmq
from zmq import zmq_poll

from cm.server.shares.budget import LITTLE, Budget, TooMuchWaiting
from cm.server.shares.paused import Connections, PausedConnections
from cm.server.shares.registry import Budgets
from cm.server.shares.rounds import Round
from cm.server.shares.turns import Turns
from cm.wire import multipart
from cm.wire.multipart import Message

_POLLIN = int(zmq.POLLIN)
_AHEAD = 32  # messages of a socket that are read before one is served
_KEEPING = 1024  # bytes of overhead for each message that waits here
_BLIND = 100_000  # nanoseconds of serving after which we look whether another client waits
_MUCH = 1 << 20  # bytes that wait here; beyond it, we look whose they are
_AGAIN = 0.005  # seconds until we look again whether answers were read
Rest = Iterator[None] | None  # what is left to be done, a slice with each `next`; None: nothing
_Serve = Callable[[Message, Budget], Rest]
_NO_MESSAGE = Message("", [], -1, 0)


class Loop(Protocol):
    """The loop whose thread runs all of this (`cm.loop.Loop`)."""

    def call_soon(self, callback: Callable[[], None]) -> None:
        """Call in the loop's next turn, which then does not wait."""

    def call_later(self, seconds: float, callback: Callable[[], None]) -> object:
        """Call once, `seconds` from now."""


class _Source:
    """A socket, and the round of its connections."""

    def __init__(
        self,
        socket: zmq.Socket[bytes],
        serve: _Serve,
        refuse: Callable[[Message, Budget, TooMuchWaiting], None],
        sender: Callable[[Message], Hashable],
    ) -> None:
        self.socket, self.serve, self.refuse, self.sender = socket, serve, refuse, sender
        self.routed = socket.type == zmq.ROUTER
        self.ready: list[tuple[Any, int]] = [(socket, _POLLIN)]
        self.round = Round()


class Intake:
    """Messages that have come and not been served yet; each turn of the loop serves one, in the loop's thread."""

    def __init__(self, budgets: Budgets, loop: Loop, connections: Connections) -> None:
        self._budgets = budgets
        self._loop = loop
        self._paused = PausedConnections(connections)
        self._looking = False  # a timer runs, because a client does not read its answers
        self._sources: list[_Source] = []
        self._turns: Turns[Budget, tuple[Hashable, _Serve, Message, int]] = Turns()
        self._called = False
        self._blind = 0  # nanoseconds of serving since we last looked who else waits

    def add(
        self,
        socket: zmq.Socket[bytes],
        serve: _Serve,
        refuse: Callable[[Message, Budget, TooMuchWaiting], None],
        sender: Callable[[Message], Hashable],
    ) -> Callable[[], None]:
        """What to call when a socket has messages. Those of one `sender` are served in order."""
        source = _Source(socket, serve, refuse, sender)
        self._sources.append(source)

        def arrived() -> None:
            self._arrived(source)

        return arrived

    def _arrived(self, source: _Source) -> None:
        if self._called:  # all sockets are looked at in that case
            return
        began, stopped = monotonic_ns(), self._turns.stopped
        message = multipart.receive_from(source.socket, source.routed, bool(stopped))
        budget = self._budgets.known.get(message.connection)
        if budget is None or message.source >= 0:
            budget = self._budgets.came(message)
        else:  # as most often
            budget.requests += 1
        if (
            (self._blind >= _BLIND and self._others_wait(source))
            or (budget.leaving_bytes > LITTLE and not budget.reads(source.sender(message)))
            or (stopped and budget in stopped)
        ):
            self._keep(source, message, budget, began)
            self._go_on()
            return
        budget.is_alone()
        rest = self._serve(budget, began, source.serve, message)
        if rest is not None:
            self._leave(rest, budget, (source, source.sender(message)), _size(message))

    def _others_wait(self, source: _Source) -> bool:
        """Whether there is more to read. Asking costs a tenth of serving a short request."""
        self._blind = 0
        return bool(zmq_poll(source.ready, 0))

    def client(self, connection: str) -> Budget:
        """The budget of the client of that connection."""
        return self._budgets.of(connection)

    def put(self, connection: str, key: Hashable, call: Callable[[], Rest]) -> None:
        """Have other work done for the client of that connection, in its turn, and in a later turn of the loop.

        Work with the same `key` is done in order. Raises TooMuchWaiting.
        """
        budget = self._budgets.of(connection)
        budget.requests += 1
        try:
            budget.queue(_KEEPING)
        except TooMuchWaiting:
            budget.refused += 1
            raise
        key = (None, key)
        self._turns.add(budget, key, (key, lambda _, __: call(), _NO_MESSAGE, _KEEPING))
        self._come_back()

    def _leave(self, rest: Iterator[None], budget: Budget, key: Hashable, size: int) -> None:
        """The rest of what was served waits for its next turn; it was let in, and is not refused any more."""
        budget.queued(1, size)
        self._turns.again(budget, key, (key, partial(_next, rest), _NO_MESSAGE, size))
        self._come_back()

    def _come_back(self) -> None:
        if not self._called:
            self._called = True
            self._loop.call_soon(self._go_on)

    def _serve(self, budget: Budget, began: int, serve: _Serve, message: Message) -> Rest:
        self._budgets.served = budget
        try:
            return serve(message, budget)
        finally:
            self._budgets.served = None
            took = monotonic_ns() - began
            self._blind += took
            budget.charge(took)

    def _keep(self, source: _Source, message: Message, budget: Budget, began: int) -> bool:
        """Let a message wait; returns whether it ended a round of its socket's connections."""
        size, sender = _size(message), source.sender(message)
        news = False
        try:
            budget.queue(size)
        except TooMuchWaiting as error:
            budget.refused += 1
            if budget.reads(sender):
                source.refuse(message, budget, error)
            elif message.source >= 0:  # the connection would not even read the refusal
                self._paused.cut(budget, message.source)
        else:
            key = source, sender
            news = self._turns.add(budget, key, (key, source.serve, message, size))
        if message.source >= 0 and self._has_enough(budget, source, sender):
            self._paused.hold(budget, message.source)
        budget.charge(monotonic_ns() - began)
        return source.round.came(sender, news)

    def _has_enough(self, budget: Budget, source: _Source, sender: Hashable) -> bool:
        """Whether a connection is not to be read for now."""
        return budget.has_much_waiting or (source, sender) in self._turns.stopped.get(budget, ())

    def _look_again(self) -> None:
        """Resume the clients that have read something."""
        self._looking = False
        if self._turns.go_on(_may_be_served):
            self._come_back()
        if self._turns.stopped:
            self._look_later()

    def _look_later(self) -> None:
        if not self._looking:
            self._looking = True
            self._loop.call_later(_AGAIN, self._look_again)

    def _take_in(self, source: _Source) -> bool:
        """Read what came meanwhile; returns whether there may be more that nothing else will report."""
        if source.round.is_quiet():
            return True
        for _ in range(_AHEAD):
            if not zmq_poll(source.ready, 0):
                return False
            began, known = monotonic_ns(), bool(self._turns.stopped) or self._budgets.queued_bytes > _MUCH
            message = multipart.receive_from(source.socket, source.routed, known)
            if self._keep(source, message, self._budgets.came(message), began):
                return True
        return True

    def _go_on(self) -> None:
        """Read what came meanwhile, and serve the client whose turn it is."""
        self._called = False
        try:
            more = [self._take_in(source) for source in self._sources]
        finally:
            if self._turns.anyone:  # also where a socket failed
                self._come_back()
        try:
            budget, (key, serve, message, size) = self._turns.take(_may_be_served)
        except IndexError:
            budget = None
        if self._turns.stopped:
            self._look_later()
        if budget is None:
            if any(more):
                self._come_back()
            return
        budget.unqueue(size)
        if not budget.waiting:  # it may have sent more
            for each in self._sources:
                each.round.quiet = 0
        if self._paused.held and budget in self._paused.held:
            self._paused.release(budget)
        rest = self._serve(budget, monotonic_ns(), serve, message)
        if rest is not None:
            self._leave(rest, budget, key, size)


def _size(message: Message) -> int:
    return sum(map(len, message.frames)) + _KEEPING


def _next(rest: Iterator[None], _: Message, __: Budget) -> Rest:
    """The next slice."""
    return rest if next(rest, rest) is None else None


def _may_be_served(budget: Budget, key: Any) -> bool:
    return budget.reads(key[1])
