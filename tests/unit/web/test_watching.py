# SPDX-License-Identifier: Apache-2.0
"""Streams and fleets that pages show."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cm.errors import CmError
from cm.web.fleet import FleetWatch
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


def test_why_a_fleet_is_not_reached_is_said_once_and_that_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    class Reached(Exception):
        """Ends the test."""

    class Fleet:
        """One that is there at the third try."""

        tries = 0

        async def __aenter__(self) -> Fleet:
            Fleet.tries += 1
            if Fleet.tries < 3:
                raise CmError("no router answers at tcp/fleet.lan:7447")
            return self

        async def __aexit__(self, *_: object) -> None: ...

        def watch(self) -> Any:
            raise Reached

    monkeypatch.setattr("cm.web.fleet._RECONNECT", 0.0)
    with pytest.raises(Reached):
        asyncio.run(FleetWatch(Fleet, Topics(), said.append).run())  # type: ignore[arg-type]
    assert said == ["no router answers at tcp/fleet.lan:7447 (the page waits for it)", "the fleet is there"]
