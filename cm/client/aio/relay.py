# SPDX-License-Identifier: Apache-2.0
"""Requests of others, passed on as bytes; a bridge uses this instead of a `Board`."""

from __future__ import annotations

import asyncio
import itertools
import os
import weakref
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import zmq
from zmq.utils.monitor import parse_monitor_message

from cm.client.connections import Sockets, not_subscribed
from cm.client.core.calls import Call
from cm.client.errors import ConnectionLost, NoAnswer
from cm.client.find_manager import Keys, find
from cm.wire.encode import decode_reply, encode_request
from cm.wire.envelope import GUEST

_T = TypeVar("_T")
Take = Callable[[list[bytes]], None]
_CONNECTING = 2.0  # seconds that a request waits for a connection: later, its effect would be unexpected
_AT_ONCE = 16  # messages that are taken before others have their turn
_EVENTS, _POLLIN = int(zmq.EVENTS), int(zmq.POLLIN)  # enumerations take longer than the call


class _Inlet:
    """A socket whose messages are taken by the event loop itself: futures for each cost several times as much.

    Its descriptor is readable once something may have come; then, and after the socket was used otherwise, all has to
    be taken (zmq_getsockopt(3), ZMQ_FD).
    """

    def __init__(self, socket: Any, take: Take) -> None:
        self._socket, self._take, self._loop = socket, take, asyncio.get_running_loop()
        self._descriptor = int(socket.fileno())
        self._loop.add_reader(self._descriptor, self.drain)
        self._loop.call_soon(self.drain)

    def drain(self) -> None:
        """Take what has come."""
        for _ in range(_AT_ONCE):
            if self._socket.closed or not self._socket.getsockopt(_EVENTS) & _POLLIN:
                return
            self._take(self._socket.recv_multipart(zmq.NOBLOCK))
        self._loop.call_soon(self.drain)

    def end(self) -> None:
        """Take nothing more; the socket is closed after that. Twice is fine."""
        self._loop.remove_reader(self._descriptor)


def _no_answer(waiting: asyncio.Future[list[bytes]], timeout: float) -> None:
    if not waiting.done():
        waiting.set_exception(NoAnswer(f"the manager gave no answer within {timeout:g} s"))


class Subscribed:
    """Topics that are listened to, until `close`."""

    def __init__(self, sockets: Sockets, topics: tuple[bytes, ...], depth: int, take: Take, refused: Take) -> None:
        self._sockets, self._pair = sockets, sockets.subscriber(topics, depth)
        self._inlets = [_Inlet(socket, each) for socket, each in zip(self._pair, (take, refused), strict=True)]

    def close(self) -> None:
        """Twice is fine."""
        for inlet in self._inlets:
            inlet.end()
        self._inlets = []
        self._sockets.hang_up(*self._pair)


class Relay:
    """One connection to a manager for all guests. For one event loop, in which it is made."""

    def __init__(
        self,
        endpoint: str | os.PathLike[str] | None = None,
        runtime_dir: str | os.PathLike[str] | None = None,
        keys: str | os.PathLike[str] | Keys | None = None,
        changed: Callable[[bool], None] = lambda _: None,
    ) -> None:
        """Arguments and errors are those of `cm.connect`. `changed` is told whether the manager is there."""
        found = find(endpoint, runtime_dir, keys)
        self._sockets = Sockets(zmq.Context(), found.endpoints, found.keys)
        self._finalizer = weakref.finalize(self, self._sockets.close)
        self._numbers = itertools.count(1)
        self._waiting: dict[bytes, asyncio.Future[list[bytes]]] = {}
        self._up = asyncio.Event()
        self._refused: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._changed = changed
        self._socket, monitor, self._handshake = self._sockets.requests(immediate=True)
        self._answers = _Inlet(self._socket, self._answered)
        self._events = _Inlet(monitor, self._happened)

    @property
    def up(self) -> bool:
        """Whether the manager is there."""
        return self._up.is_set()

    async def forward(self, frames: Sequence[Any], guest: str = "", timeout: float | None = None) -> list[bytes]:
        """Hand on ``[topic][message][payload…]`` in a guest's name; the reply's frames.

        Raises ConnectionLost, NoAnswer after `timeout` seconds (None: never), NotAdmitted.
        """
        await self._connected()
        number, loop = b"%d" % next(self._numbers), asyncio.get_running_loop()
        waiting: asyncio.Future[list[bytes]] = loop.create_future()
        self._waiting[number] = waiting
        named = [GUEST + guest.encode()] if guest else []
        end = None if timeout is None else loop.call_later(timeout, _no_answer, waiting, timeout)
        try:
            self._socket.send_multipart([number, *named, b"", *frames], zmq.NOBLOCK)
            self._answers.drain()
            return await waiting
        except zmq.Again:  # the connection has just ended: what cannot be sent now must not be sent later
            raise self._lost() from None
        finally:
            self._waiting.pop(number, None)
            if end is not None:
                end.cancel()

    async def ask(self, call: Call[_T], guest: str = "", timeout: float | None = 10.0) -> _T:
        """Make a request of our own. Raises what `forward` does, and the manager's refusal."""
        return call.result(decode_reply(await self.forward(encode_request(call.request), guest, timeout)))

    def subscribe(self, *topics: bytes, take: Take, depth: int = 0) -> Subscribed:
        """Have `take` called in the event loop with the frames of each message of some topics, in our own name.

        At most `depth` wait to be taken (0: ZeroMQ's own number). The caller closes it.
        """

        def refuse(_: list[bytes]) -> None:
            if not self._refused.done():
                self._refused.set_exception(not_subscribed(self._sockets.endpoints.pub))

        return Subscribed(self._sockets, topics, depth, take, refuse)

    async def refused(self) -> None:
        """Wait until the manager refuses a subscription, which is raised: NotAdmitted."""
        await asyncio.shield(self._refused)

    async def close(self) -> None:
        """Disconnect; calls that wait get ConnectionLost. Of the manager nothing is told any more."""
        self._changed = lambda _: None
        for inlet in (self._answers, self._events):
            inlet.end()
        self._went_away()
        if not self._socket.closed:
            self._socket.disable_monitor()
        self._finalizer()

    async def _connected(self) -> None:
        if self._handshake.refused is not None:
            raise self._handshake.refused
        if self.up:
            return
        try:
            await asyncio.wait_for(self._up.wait(), _CONNECTING)
        except asyncio.TimeoutError:
            raise self._handshake.refused or self._lost() from None

    def _lost(self) -> ConnectionLost:
        return ConnectionLost(f"no configuration manager answers at {self._sockets.endpoints.req}")

    def _answered(self, frames: list[bytes]) -> None:
        waiting = self._waiting.pop(frames[0], None)
        if waiting is not None and not waiting.done():
            waiting.set_result(frames[frames.index(b"", 1) + 1 :])

    def _happened(self, frames: list[bytes]) -> None:
        """If the manager goes away, raise that in all calls that wait; nothing is requested again for them."""
        event = parse_monitor_message(frames)
        self._handshake.take(int(event["event"]), int(event["value"]))
        if event["event"] == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._up.set()
            self._changed(True)
        elif self._handshake.lost or self._handshake.refused is not None:
            self._handshake.lost = False
            self._went_away()

    def _went_away(self) -> None:
        was, waiting, self._waiting = self.up, self._waiting, {}
        self._up.clear()
        for future in waiting.values():
            if not future.done():
                future.set_exception(self._handshake.refused or self._lost())
        if was:
            self._changed(False)
