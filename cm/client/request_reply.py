# SPDX-License-Identifier: Apache-2.0
"""Blocking request and reply over a DEALER, with a time-out, and an error if the manager goes away."""

from __future__ import annotations

import struct
import time
from time import monotonic
from typing import Any, Protocol, TypeVar

import zmq
from zmq import zmq_poll

from cm.client.connections import Socket, Sockets, not_subscribed
from cm.client.core.calls import Call
from cm.client.core.flow_effects import DEFAULT, AskBeside, Deadline, Flow, Limit, Pause, Receive, seconds
from cm.client.core.requests import CONNECTING, Requests
from cm.client.errors import ConnectionLost, NotAdmitted
from cm.wire import multipart
from cm.wire.encode import decode_reply

_T = TypeVar("_T")


class Caller(Protocol):
    """What a board's parts need of it: they hold it, so that it stays open while one of them is used."""

    def ask(self, call: Call[_T], timeout: Limit = DEFAULT) -> _T:
        """Make a call and return its result."""

    def run(self, flow: Flow[_T]) -> _T:
        """Run a flow of `cm.client.core` to its end."""

    def subscribe(self, *topics: bytes, depth: int = 0) -> Subscription:
        """Listen to topics; the caller closes it."""


_TOLD = struct.Struct("=Hi")  # event and value, zmq_socket_monitor(3); pyzmq's own reader of it imports asyncio
_NOBLOCK = int(zmq.NOBLOCK)
_POLLIN = int(zmq.POLLIN)  # an operation on pyzmq's enums costs as much as a system call


class Subscription:
    """A SUB socket: topics that are listened to."""

    def __init__(self, sockets: Sockets, topics: tuple[bytes, ...], depth: int = 0) -> None:
        self._sockets = sockets
        self.socket: Socket
        self.socket, self._monitor = sockets.subscriber(topics, depth)
        self._turn = sockets.turn()
        self._sources: list[tuple[Any, int]] = [(self.socket, _POLLIN), (self._monitor, _POLLIN)]

    def receive(self, timeout: float | None) -> list[bytes] | None:
        """The next message; None if there is none within `timeout` seconds. Raises BoardClosed, NotAdmitted."""
        if self._sockets.closed:  # before the turn too: after a fork it may never come
            raise self._sockets.gone()
        with self._turn:
            self._check_open()
            with self._sockets.ending():
                ready = dict(zmq_poll(self._sources, -1 if timeout is None else _milliseconds(timeout)))
                if self.socket in ready:
                    return self.socket.recv_multipart()
        if ready:
            raise not_subscribed(self._sockets.endpoints.pub)
        return None

    def _check_open(self) -> None:
        if self._sockets.closed or self.socket.closed:
            raise self._sockets.gone()

    def fileno(self) -> int:
        """Readable when something may have come; then take all there is (zmq_getsockopt(3), ZMQ_FD)."""
        with self._sockets.ending():
            return int(self.socket.fileno())

    def unsubscribe(self, topic: bytes) -> None:
        """Stop listening to one of the topics."""
        self.socket.setsockopt(zmq.UNSUBSCRIBE, topic)

    def close(self) -> None:
        """Twice is fine."""
        self._sockets.hang_up(self.socket, self._monitor)


class Link:
    """One connection for requests; threads take turns."""

    def __init__(self, sockets: Sockets, timeout: float | None, guest: str = "") -> None:
        self.timeout = timeout  # seconds, for requests without a time-out of their own
        self._sockets = sockets
        self._requests = Requests(sockets.endpoints.req, guest)
        self.unanswered: set[bytes] = set()  # requests that were given up, and may still take effect
        self._turn = sockets.turn()
        self._socket: Socket
        self._open()

    def _open(self) -> None:
        self._socket, self._monitor, self._handshake = self._sockets.requests()
        self._sources: list[tuple[Any, int]] = [(self._socket, _POLLIN), (self._monitor, _POLLIN)]
        self.unanswered.clear()

    def ask(self, call: Call[_T], timeout: float | None, beside: AskBeside | None = None) -> _T:
        """Make a request and wait for its reply; meanwhile messages of the subscription `beside` are handled.

        Raises NoAnswer after `timeout` seconds (None: never), ConnectionLost if the manager goes away, NotAdmitted if
        it does not admit us, BoardClosed, and the manager's refusal.
        """
        if self._sockets.closed:  # before the turn too: after a fork it may never come
            raise self._sockets.gone()
        with self._turn:
            if self._sockets.closed or self._socket.closed:
                raise self._sockets.gone()
            number, frames = self._requests.begin(call)
            try:
                if zmq_poll(self._sources[1:], 0):
                    self._take_events()
                if self._handshake.lost:  # that was before
                    self._handshake.lost = False
                    self.unanswered.clear()
                try:
                    multipart.send(self._socket, frames, _NOBLOCK)
                except zmq.Again:  # a socket whose peer broke the protocol has none any more
                    self._take_events()
                    self.close()
                    self._open()
                    multipart.send(self._socket, frames, _NOBLOCK)
                try:
                    reply = self._wait(number, timeout, beside)
                except (ConnectionLost, NotAdmitted):
                    raise
                except BaseException:
                    self.unanswered.add(number)
                    raise
            except zmq.ContextTerminated:  # closed by another thread
                raise self._sockets.gone() from None
        return call.result(decode_reply(reply))

    def run(self, flow: Flow[_T]) -> _T:
        """Run a flow to its end. Raises what it raises."""
        answer: Any = None
        problem: BaseException | None = None
        while True:
            try:
                effect = flow.throw(problem) if problem else flow.send(answer)
            except StopIteration as end:
                value: _T = end.value
                return value
            try:
                answer, problem = self._do(effect), None
            except Exception as error:  # noqa: BLE001 (the flow decides)
                problem = error

    def _do(self, effect: Any) -> Any:
        if isinstance(effect, Call):
            return self.ask(effect, self.timeout)
        if isinstance(effect, Receive):
            return effect.subscription.receive(effect.timeout)
        if isinstance(effect, Pause):
            return time.sleep(effect.seconds)
        beside = effect if isinstance(effect, AskBeside) else None
        return self.ask(effect.call, seconds(effect.timeout, self.timeout), beside)

    def _wait(self, number: bytes, timeout: float | None, beside: AskBeside | None) -> list[bytes | memoryview]:
        until = None if timeout is None else monotonic() + timeout
        connecting: Deadline | None = None
        other = beside.subscription.socket if beside else None
        sources = self._sources if other is None else [*self._sources, (other, _POLLIN)]
        while True:
            left = None if until is None else max(0.0, until - monotonic())
            if not self._handshake.up:  # a request waits as long as it may, but for a connection no longer than others
                if absent := self._requests.absent():
                    raise absent
                connecting = connecting or Deadline(self.timeout)
                left = min(x for x in (left, connecting.left, CONNECTING) if x is not None)
            ready = dict(zmq_poll(sources, -1 if left is None else int(left * 1000) + 1 if left > 0 else 0))
            if beside is not None and other is not None and other in ready:
                beside.take(other.recv_multipart())
            if self._socket in ready:
                frames = multipart.receive(self._socket)
                if frames[0] == number:
                    body = frames[self._requests.envelope :]
                    return [*map(bytes, body[:2]), *body[2:]]  # payloads stay where libzmq put them
                self.unanswered.discard(bytes(frames[0]))  # it timed out
            elif self._monitor in ready:
                self._take_events()
                if self._handshake.lost:
                    raise self._requests.lost()
            elif not ready and left == 0:
                late = connecting is None or (until is not None and until <= monotonic())
                over = timeout if late or connecting is None else connecting.limit
                raise self._handshake.suspected or self._requests.no_answer(over)

    def _take_events(self) -> None:
        """Handle the monitor's events. Raises NotAdmitted; the next request tries again."""
        while zmq_poll(self._sources[1:], 0):
            event, value = _TOLD.unpack(self._monitor.recv_multipart()[0])
            self._handshake.take(event, value)
        refused = self._handshake.refused
        if refused is not None:
            self.close()
            self._open()
            raise refused

    def close(self) -> None:
        """Disconnect; twice is fine."""
        self._sockets.hang_up(self._socket, self._monitor)


def _milliseconds(left: float) -> int:
    return int(left * 1000) + 1 if left > 0 else 0
