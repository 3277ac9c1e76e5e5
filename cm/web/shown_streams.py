# SPDX-License-Identifier: Apache-2.0
"""Streams that pages show: each is read once, however many pages show it, and not at all if none does.

Frames are read as they come, so that the hardware and other readers are not held up; at most thirty a second are made
into pictures. A slow page gets the newest when it has drawn the last.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable
from typing import Any

from cm.client.aio.stream import Stream
from cm.client.frame import Frame
from cm.errors import CmError
from cm.frozen import dataclass
from cm.web import pictures
from cm.web.hub import Hub

_EVERY = 1 / 30  # seconds between two pictures at least
_REREAD = 1.0  # seconds before a stream that could not be read is tried again
_LINGER = 2.0  # seconds for which a stream is still read when no page watches it: a page may just be reloading
OnPicture = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Wanted:
    """How a page wants a stream's frames: `pictures.message` has the words."""

    view: str
    near: bool


class Watched:
    """A stream that at least one page shows."""

    def __init__(self) -> None:
        self.watchers: dict[Hashable, tuple[Wanted, OnPicture]] = {}
        self.pictures: dict[Wanted, bytes] = {}  # the newest
        self.number = 0  # of the newest
        self.problem = ""
        self.task: asyncio.Task[None] | None = None

    @property
    def wanted(self) -> set[Wanted]:
        """The kinds of picture that pages want of it."""
        return {wanted for wanted, _ in self.watchers.values()}


class Watching:
    """All streams that are looked at."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._streams: dict[str, Watched] = {}

    def watch(self, watcher: Hashable, stream: str, wanted: Wanted, on_picture: OnPicture) -> None:
        """Call `on_picture` with the stream's name for each new one."""
        watched = self._streams.setdefault(stream, Watched())
        watched.watchers[watcher] = (wanted, on_picture)
        if watched.task is None:
            watched.task = asyncio.create_task(self._read(stream, watched))

    def leave(self, watcher: Hashable, stream: str) -> None:
        """Stop watching; fine if it was not watched."""
        watched = self._streams.get(stream)
        if watched is None:
            return
        watched.watchers.pop(watcher, None)
        if not watched.watchers:
            asyncio.get_running_loop().call_later(_LINGER, self._end_unwatched, stream)

    def newest(self, stream: str, wanted: Wanted, after: int) -> tuple[int, bytes] | None:
        """The newest picture and its number, if it is newer than number `after`."""
        watched = self._streams.get(stream)
        if watched is None or watched.number <= after or wanted not in watched.pictures:
            return None
        return watched.number, watched.pictures[wanted]

    async def close(self) -> None:
        """Read nothing any more."""
        streams, self._streams = self._streams, {}
        tasks = [watched.task for watched in streams.values() if watched.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _end_unwatched(self, stream: str) -> None:
        watched = self._streams.get(stream)
        if watched is not None and not watched.watchers:
            del self._streams[stream]
            self._tell()
            if watched.task is not None:
                watched.task.cancel()

    def _tell(self) -> None:
        self._hub.topics.tell("watched", {name: watched.problem for name, watched in self._streams.items()})

    async def _read(self, stream: str, watched: Watched) -> None:
        while True:
            await self._hub.connected.wait()
            try:
                await self._read_on(stream, watched)
            except (CmError, OSError) as error:
                watched.problem = str(error)
                self._tell()
            await asyncio.sleep(_REREAD)

    async def _read_on(self, stream: str, watched: Watched) -> None:
        board, status = self._hub.board, self._hub.status
        if board is None or status is None:
            return
        if any(s.name == stream and s.backpressure for s in status.streams):
            watched.problem = "the hardware waits for every reader of this stream: a page would hold it up"
            self._tell()
            return
        async with board.stream(stream, timeout=None, newest=True) as opened:
            watched.problem = ""
            self._tell()
            await self._show(stream, watched, opened)

    async def _show(self, stream: str, watched: Watched, opened: Stream) -> None:
        making: asyncio.Task[None] | None = None
        due = 0.0
        try:
            while True:
                frame = await opened.read()
                now = time.monotonic()
                if now < due or (making is not None and not making.done()):
                    frame.release()
                    continue
                if making is not None:
                    making.result()
                due = max(due + _EVERY, now)
                making = asyncio.create_task(self._make(stream, watched, frame))
        finally:
            if making is not None:
                await asyncio.gather(making, return_exceptions=True)  # to its end: a thread reads the frame

    async def _make(self, stream: str, watched: Watched, frame: Frame) -> None:
        about: dict[str, Any] = {"sequence": frame.sequence, "mode": frame.info.mode}
        try:
            made = {
                wanted: await asyncio.to_thread(pictures.message, stream, frame, about, wanted.view, wanted.near)
                for wanted in watched.wanted
            }
        finally:
            frame.release()
        watched.pictures = made
        watched.number += 1
        for _, on_picture in tuple(watched.watchers.values()):
            on_picture(stream)
