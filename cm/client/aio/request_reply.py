# SPDX-License-Identifier: Apache-2.0
"""Requests and subscriptions of one event loop; several requests may be under way."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Protocol, TypeVar

import zmq.asyncio
from zmq.utils.monitor import parse_monitor_message

from cm.client.aio.waiting import wake, within
from cm.client.connections import Sockets, not_subscribed
from cm.client.core.calls import Call
from cm.client.core.connection_monitor import Handshake
from cm.client.core.flow_effects import DEFAULT, Ask, AskBeside, Deadline, Flow, Limit, Pause, Receive, seconds
from cm.client.core.requests import CONNECTING, LOOKS, Requests
from cm.client.errors import NoAnswer
from cm.wire.encode import decode_reply

_T = TypeVar("_T")


class Caller(Protocol):
    """As `cm.client.request_reply.Caller`, awaited."""

    async def ask(self, call: Call[_T], timeout: Limit = DEFAULT) -> _T:
        """Make a call and return its result."""

    async def run(self, flow: Flow[_T]) -> _T:
        """Run a flow of `cm.client.core` to its end."""

    def subscribe(self, *topics: bytes, depth: int = 0) -> Subscription:
        """Listen to topics; the caller closes it."""


class Subscription:
    """A SUB socket: topics that are listened to."""

    def __init__(self, sockets: Sockets, topics: tuple[bytes, ...], depth: int = 0) -> None:
        self._sockets = sockets
        self.socket: zmq.asyncio.Socket
        self.socket, self._monitor = sockets.subscriber(topics, depth)
        self._poller = zmq.asyncio.Poller()
        for source in (self.socket, self._monitor):
            self._poller.register(source, zmq.POLLIN)

    async def receive(self, timeout: float | None) -> list[bytes] | None:
        """The next message; None if there is none within `timeout` seconds. Raises BoardClosed, NotAdmitted."""
        if self._sockets.closed or self.socket.closed:
            raise self._sockets.gone()
        with suppress(zmq.Again):  # what has come needs no poll, which takes several times as long
            frames: list[bytes] = await self.socket.recv_multipart(zmq.NOBLOCK)
            await asyncio.sleep(0)  # others have their turn, however much comes
            return frames
        ready = await self._polled(-1 if timeout is None else int(timeout * 1000) + (timeout > 0))
        if self.socket in ready:
            return await self.socket.recv_multipart()
        if ready:
            raise not_subscribed(self._sockets.endpoints.pub)
        return None

    async def _polled(self, milliseconds: int) -> dict[Any, int]:
        """Which sockets are readable. Raises BoardClosed; pyzmq cancels what waits for a socket that is closed."""
        polled = asyncio.ensure_future(self._poller.poll(milliseconds))
        over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        polled.add_done_callback(lambda _: wake(over))
        try:
            await over  # awaiting `polled` itself would look as if this task had been cancelled
        finally:
            polled.cancel()
        if polled.cancelled():
            raise self._sockets.gone()
        return dict(polled.result())

    def fileno(self) -> int:
        """A descriptor that is readable when something may have come; then take all (zmq_getsockopt(3), ZMQ_FD)."""
        return int(self.socket.fileno())

    def unsubscribe(self, topic: bytes) -> None:
        """Stop listening to one of the topics."""
        self.socket.setsockopt(zmq.UNSUBSCRIBE, topic)

    def close(self) -> None:
        """Twice is fine."""
        self._sockets.hang_up(self.socket, self._monitor)


class Link:
    """One connection for requests, made by `open` in the event loop that uses it."""

    def __init__(self, sockets: Sockets, timeout: float | None, guest: str = "") -> None:
        self.timeout = timeout  # seconds, for requests without a time-out of their own
        self._sockets = sockets
        self._requests = Requests(sockets.endpoints.req, guest)
        self._pending: dict[bytes, asyncio.Future[list[bytes]]] = {}
        self.unanswered: set[bytes] = set()  # requests that may still take effect
        self._socket: zmq.asyncio.Socket | None = None
        self._monitor: zmq.asyncio.Socket | None = None
        self._handshake: Handshake | None = None
        self._tasks: tuple[asyncio.Task[None], ...] = ()

    def open(self) -> None:
        """Connect; again is fine. Raises BoardClosed."""
        if self._sockets.closed:
            raise self._sockets.gone()
        if self._socket is None:
            self._socket, self._monitor, self._handshake = self._sockets.requests()
            self._tasks = (asyncio.create_task(self._read()), asyncio.create_task(self._look()))

    async def gone(self) -> None:
        """Wait for nothing but the manager's end, which is raised as in every call that waits: ConnectionLost."""
        self.open()
        end: asyncio.Future[list[bytes]] = asyncio.get_running_loop().create_future()
        name = b"until the end %d" % id(end)  # no request's number
        self._pending[name] = end
        try:
            await end
        finally:
            self._pending.pop(name, None)

    async def _read(self) -> None:
        assert self._socket is not None
        while True:
            frames = await self._socket.recv_multipart()
            self.unanswered.discard(frames[0])
            waiting = self._pending.pop(frames[0], None)
            if waiting is not None and not waiting.done():
                waiting.set_result(frames[self._requests.envelope :])

    async def _look(self) -> None:
        """If the manager goes away, or does not admit us, raise that in all calls that wait."""
        assert self._monitor is not None
        assert self._handshake is not None
        handshake = self._handshake
        while handshake.refused is None:
            event = parse_monitor_message(await self._monitor.recv_multipart())
            handshake.take(int(event["event"]), int(event["value"]))
            if handshake.lost:
                handshake.lost = False
                self._fail(self._requests.lost)
        refused = handshake.refused
        self._renew(lambda: refused)

    def _renew(self, problem: Callable[[], Exception]) -> None:
        """The next request connects anew; those that wait get the problem."""
        self._fail(problem)
        for task in self._tasks:
            if task is not asyncio.current_task():
                task.cancel()
        self._hang_up()
        self._socket, self._tasks = None, ()

    def _hang_up(self) -> None:
        if self._socket is not None:
            self._sockets.hang_up(self._socket, self._monitor)

    def _fail(self, problem: Callable[[], Exception]) -> None:
        self.unanswered.clear()
        pending, self._pending = self._pending, {}
        for waiting in pending.values():
            if not waiting.done():
                waiting.set_exception(problem())

    async def ask(self, call: Call[_T], timeout: float | None) -> _T:
        """Make a request and wait for its reply.

        Raises NoAnswer after `timeout` seconds (None: never), ConnectionLost if the manager goes away, NotAdmitted if
        it does not admit us, BoardClosed, and the manager's refusal.
        """
        self.open()
        assert self._socket is not None
        number, frames = self._requests.begin(call)
        waiting: asyncio.Future[list[bytes]] = asyncio.get_running_loop().create_future()
        self._pending[number] = waiting
        if not isinstance(call.request, LOOKS):
            self.unanswered.add(number)
        sending = asyncio.ensure_future(self._socket.send_multipart(frames))  # would never end if we are not admitted
        sending.add_done_callback(partial(_hand_on, waiting))
        looking = asyncio.create_task(self._connected(waiting)) if not self._up() else None
        try:
            reply = await within(waiting, timeout)
        except NoAnswer:  # a TimeoutError too
            raise
        except asyncio.TimeoutError:
            suspected = self._handshake.suspected if self._handshake else None
            raise suspected or self._requests.no_answer(timeout) from None
        finally:
            self._pending.pop(number, None)
            if sending.cancel():  # not sent: a socket whose peer broke the protocol has none for ever
                self._renew(self._requests.lost)
            if looking is not None:
                looking.cancel()
        return call.result(decode_reply(reply))

    def _up(self) -> bool:
        return self._handshake is not None and self._handshake.up

    async def _connected(self, waiting: asyncio.Future[list[bytes]]) -> None:
        """A request waits as long as it may, but for a connection no longer than others."""
        connecting = Deadline(self.timeout)
        while not self._up() and not waiting.done():
            if problem := self._requests.absent() or (connecting.left == 0 and self._requests.no_answer(self.timeout)):
                waiting.set_exception(problem)
                return
            await asyncio.sleep(CONNECTING)

    async def run(self, flow: Flow[_T]) -> _T:
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
                answer, problem = await self._do(effect), None
            except Exception as error:  # noqa: BLE001 (the flow decides)
                problem = error

    async def _do(self, effect: Any) -> Any:
        if isinstance(effect, Call):
            return await self.ask(effect, self.timeout)
        if isinstance(effect, Ask):
            return await self.ask(effect.call, seconds(effect.timeout, self.timeout))
        if isinstance(effect, Receive):
            return await effect.subscription.receive(effect.timeout)
        if isinstance(effect, Pause):
            return await asyncio.sleep(effect.seconds)
        return await self._ask_beside(effect)

    async def _ask_beside(self, effect: AskBeside) -> Any:
        teller = asyncio.create_task(_tell(effect))
        try:
            return await self.ask(effect.call, seconds(effect.timeout, self.timeout))
        finally:
            teller.cancel()
            with suppress(asyncio.CancelledError):
                await teller

    async def close(self) -> None:
        """Disconnect; twice is fine. Calls that wait get BoardClosed."""
        tasks, self._tasks = self._tasks, ()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._fail(self._sockets.gone)
        self._hang_up()


def _hand_on(waiting: asyncio.Future[Any], sending: asyncio.Future[Any]) -> None:
    """Pass an error in sending to the call that waits for the reply."""
    problem = None if sending.cancelled() else sending.exception()
    if problem is not None and not waiting.done():
        waiting.set_exception(problem)


async def _tell(effect: AskBeside) -> None:
    while True:
        frames = await effect.subscription.receive(None)
        if frames is not None:
            effect.take(frames)
