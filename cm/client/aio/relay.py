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
import zmq.asyncio
from zmq.utils.monitor import parse_monitor_message

from cm.client import place
from cm.client.address import Keys
from cm.client.aio.link import Subscription
from cm.client.core.calls import Call
from cm.client.core.requests import result
from cm.client.errors import ConnectionLost, NoAnswer
from cm.client.sockets import Sockets
from cm.wire.encode import encode_request
from cm.wire.envelope import GUEST

_T = TypeVar("_T")
_CONNECTING = 2.0  # seconds that a request waits for a connection: later, its effect would be unexpected


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
        found = place.find(endpoint, runtime_dir, keys)
        self._sockets = Sockets(zmq.asyncio.Context(), found.endpoints, found.keys)
        self._finalizer = weakref.finalize(self, self._sockets.close)
        self._numbers = itertools.count(1)
        self._waiting: dict[bytes, asyncio.Future[list[bytes]]] = {}
        self._up = asyncio.Event()
        self._changed = changed
        self._socket, self._monitor, self._handshake = self._sockets.requests(immediate=True)
        self._tasks = (asyncio.create_task(self._read()), asyncio.create_task(self._look()))

    @property
    def up(self) -> bool:
        """Whether the manager is there."""
        return self._up.is_set()

    async def forward(self, frames: Sequence[Any], guest: str = "", timeout: float | None = None) -> list[bytes]:
        """Hand on ``[topic][message][payload…]`` in a guest's name; the reply's frames.

        Raises ConnectionLost, NoAnswer after `timeout` seconds (None: never), NotAdmitted.
        """
        await self._connected()
        number = b"%d" % next(self._numbers)
        waiting: asyncio.Future[list[bytes]] = asyncio.get_running_loop().create_future()
        self._waiting[number] = waiting
        named = [GUEST + guest.encode()] if guest else []
        sending = asyncio.ensure_future(self._socket.send_multipart([number, *named, b"", *frames]))
        try:
            return await asyncio.wait_for(waiting, timeout)
        except asyncio.TimeoutError:
            raise NoAnswer(f"the manager gave no answer within {timeout or 0:g} s") from None
        finally:
            self._waiting.pop(number, None)
            sending.cancel()  # what has not been sent by now must not be sent later

    async def ask(self, call: Call[_T], guest: str = "", timeout: float | None = 10.0) -> _T:
        """Make a request of our own. Raises what `forward` does, and the manager's refusal."""
        return result(call, await self.forward(encode_request(call.request), guest, timeout))

    def subscribe(self, *topics: bytes, depth: int = 0) -> Subscription:
        """Listen to topics, in the bridge's own name. The caller closes it."""
        return Subscription(self._sockets, topics, depth)

    async def close(self) -> None:
        """Disconnect; calls that wait get ConnectionLost. Of the manager nothing is told any more."""
        self._changed = lambda _: None
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
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

    async def _read(self) -> None:
        while True:
            frames = await self._socket.recv_multipart()
            waiting = self._waiting.pop(frames[0], None)
            if waiting is not None and not waiting.done():
                waiting.set_result(frames[frames.index(b"", 1) + 1 :])

    async def _look(self) -> None:
        """If the manager goes away, raise that in all calls that wait; nothing is requested again for them."""
        while self._handshake.refused is None:
            event = parse_monitor_message(await self._monitor.recv_multipart())
            self._handshake.take(int(event["event"]), int(event["value"]))
            if event["event"] == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self._up.set()
                self._changed(True)
            elif self._handshake.lost:
                self._handshake.lost = False
                self._went_away()
        self._went_away()

    def _went_away(self) -> None:
        was, waiting, self._waiting = self.up, self._waiting, {}
        self._up.clear()
        for future in waiting.values():
            if not future.done():
                future.set_exception(self._handshake.refused or self._lost())
        if was:
            self._changed(False)
