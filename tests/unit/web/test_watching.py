# SPDX-License-Identifier: Apache-2.0
"""Streams that pages show."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np

from cm.web.shown_streams import Watching
from cm.web.topics import Topics


class SlowFrame:
    """A frame whose picture is finished when `go` is set."""

    sequence, info = 1, SimpleNamespace(mode="default")

    def __init__(self) -> None:
        self.begun, self.go = threading.Event(), threading.Event()
        self.released = False

    def __array__(self, *_: Any, **__: Any) -> Any:
        self.begun.set()
        assert self.go.wait(60)
        return np.zeros((2, 2), np.uint8)

    def release(self) -> None:
        self.released = True


class OneFrame:
    """A board with a stream of one frame; `held`: whether that was still used when the stream was closed."""

    def __init__(self, frame: SlowFrame) -> None:
        self._frames = [frame]
        self._frame = frame
        self.held: bool | None = None

    @asynccontextmanager
    async def stream(self, *_: Any, **__: Any) -> AsyncIterator[OneFrame]:
        try:
            yield self
        finally:
            self.held = not self._frame.released

    async def read(self) -> SlowFrame:
        return self._frames.pop() if self._frames else await asyncio.Future()


def test_a_stream_is_closed_when_its_last_picture_is_made() -> None:
    frame = SlowFrame()
    board = OneFrame(frame)

    async def watched() -> set[asyncio.Task[Any]]:
        hub: Any = SimpleNamespace(
            board=board, status=SimpleNamespace(streams=()), connected=asyncio.Event(), topics=Topics()
        )
        hub.connected.set()
        watching = Watching(hub)
        watching.watch("page", "camera", "raw", lambda _: None)
        await asyncio.to_thread(frame.begun.wait, 60)
        closing = asyncio.create_task(watching.close())
        for _ in range(10):
            await asyncio.sleep(0)  # a turn of the loop
        frame.go.set()
        await closing
        return asyncio.all_tasks() - {asyncio.current_task()}

    assert asyncio.run(watched()) == set()
    assert board.held is False
