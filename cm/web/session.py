# SPDX-License-Identifier: Apache-2.0
"""One page: its requests, and what it is sent. A slow page gets only the latest state of each topic."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Mapping
from typing import Any

from aiohttp import WSMsgType, web

from cm.errors import CmError
from cm.web.commands import Commands
from cm.web.gate import Gate
from cm.web.hub import Hub
from cm.web.shown_streams import Wanted, Watching

_PAUSE = 0.02  # seconds between two messages, so that changes at about the same time are sent together
_HELLO = 10.0  # seconds in which a page has to say who it is
_UNDER_WAY = 2  # pictures of a stream that a page has not drawn yet
_ASKED = 8  # requests of a page that may be under way
DENIED = 4401  # close code: the token is wrong


class Session:
    """A page's WebSocket."""

    def __init__(
        self, socket: web.WebSocketResponse, hub: Hub, watching: Watching, commands: Commands, near: bool
    ) -> None:
        """`near`: the page is on this machine."""
        self._socket = socket
        self._hub, self._watching, self._commands = hub, watching, commands
        self._near = near
        self._changed: dict[str, None] = {}  # topics, in order
        self._wake = asyncio.Event()
        self._replies: deque[str] = deque()
        self._wanted: dict[str, Wanted] = {}  # by stream that is watched
        self._sent: dict[str, int] = {}  # by stream: number of the last picture
        self._waiting: dict[str, int] = {}  # by stream: pictures that were sent and not drawn yet
        self._tasks: set[asyncio.Task[None]] = set()

    async def is_known(self, gate: Gate) -> bool:
        """Whether the page says the token, first and soon; it is turned away if not."""
        known = await self._knows(gate)
        if not known:
            await self._socket.close(code=DENIED, message=b"the token is wrong")
        return known

    async def serve(self) -> None:
        """Until the page goes."""
        self._hub.topics.listen(self._tell)
        for topic in self._hub.topics.names():
            self._tell(topic)
        self._reply({"history": self._hub.history.plain()})
        teller = asyncio.create_task(self._tell_on())
        try:
            async for message in self._socket:
                if message.type is WSMsgType.TEXT:
                    self._take(_read(message.data))
        except (ValueError, TypeError, AttributeError, KeyError, OverflowError):  # int() of 1e999
            await self._socket.close(code=1003, message=b"that is not a message of the page's")
        finally:
            self._hub.topics.ignore(self._tell)
            for stream in self._wanted:
                self._watching.leave(self, stream)
            for task in (teller, *self._tasks):
                task.cancel()
            await asyncio.gather(teller, *self._tasks, return_exceptions=True)

    async def _knows(self, gate: Gate) -> bool:
        try:
            message = await self._socket.receive(timeout=_HELLO)
            return message.type is WSMsgType.TEXT and gate.knows(_read(message.data).get("token"))
        except (ValueError, AttributeError, asyncio.TimeoutError):
            return False

    # ---- from the page ------------------------------------------------------------------------

    def _take(self, message: Any) -> None:
        if not isinstance(message, dict):
            raise TypeError(f"{message!r} is not a message")
        if "drawn" in message:
            stream = str(message["drawn"])
            if self._waiting.get(stream):
                self._waiting[stream] -= 1
                self._wake.set()
        elif "watch" in message:
            self._watch({str(stream): Wanted(str(view), self._near) for stream, view in message["watch"].items()})
        elif "do" in message:
            self._do(message)

    def _watch(self, wanted: Mapping[str, Wanted]) -> None:
        known = {s.name for s in self._hub.status.streams} if self._hub.status else set()
        for stream in self._wanted.keys() - wanted.keys():
            self._watching.leave(self, stream)
            for kept in (self._wanted, self._sent, self._waiting):
                kept.pop(stream, None)
        for stream, how in wanted.items():
            if stream in known and self._wanted.get(stream) != how:
                self._wanted[stream] = how
                self._watching.watch(self, stream, how, lambda _: self._wake.set())

    def _do(self, message: Mapping[str, Any]) -> None:
        number, what, words = int(message["id"]), str(message["do"]), dict(message.get("with") or {})
        if len(self._tasks) >= _ASKED:
            self._reply({"reply": number, "error": {"code": "busy", "message": "too many requests are under way"}})
            return
        task = asyncio.create_task(self._answer(number, what, words))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, number: int, what: str, words: Mapping[str, Any]) -> None:
        try:
            self._reply({"reply": number, "result": await self._commands.do(what, words)})
        except (CmError, OSError, TypeError) as error:
            code = error.code if isinstance(error, CmError) else "invalid_request"
            self._reply({"reply": number, "error": {"code": code, "message": str(error)}})

    # ---- to the page --------------------------------------------------------------------------

    def _tell(self, topic: str) -> None:
        self._changed[topic] = None
        self._wake.set()

    def _reply(self, message: Mapping[str, Any]) -> None:
        self._replies.append(json.dumps(message))
        self._wake.set()

    async def _tell_on(self) -> None:
        try:
            while True:
                await self._wake.wait()
                self._wake.clear()
                changed, self._changed = self._changed, {}
                if changed:
                    await self._socket.send_str(self._hub.topics.message(changed))
                while self._replies:
                    await self._socket.send_str(self._replies.popleft())
                for stream in tuple(self._wanted):
                    await self._send_picture(stream)
                await asyncio.sleep(_PAUSE)
        except ConnectionError:  # the page has gone, which ends the other direction as well
            return

    async def _send_picture(self, stream: str) -> None:
        if self._waiting.get(stream, 0) >= _UNDER_WAY:
            return
        wanted = self._wanted.get(stream)
        newest = wanted and self._watching.newest(stream, wanted, self._sent.get(stream, 0))
        if newest:
            self._sent[stream] = newest[0]
            self._waiting[stream] = self._waiting.get(stream, 0) + 1
            await self._socket.send_bytes(newest[1])


def _read(text: str) -> Any:
    """What a page says. Raises ValueError, also where brackets within brackets are more than Python's stack."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
