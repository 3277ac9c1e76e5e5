# SPDX-License-Identifier: Apache-2.0
"""One interface to both clients: the asyncio client wrapped as a blocking one, with its own event loop."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import cm

# a property of the blocking client is a method without arguments of the other
PROPERTIES = {"status", "mode", "modes", "regions", "clocks", "configs", "info", "names", "count", "done", "generation"}


class EventLoop:
    """An event loop in a thread."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever)
        self._thread.start()

    def run(self, awaitable: Any) -> Any:
        """Wait for an awaitable and return its result."""

        async def wait() -> Any:
            return await awaitable

        return asyncio.run_coroutine_threadsafe(wait(), self.loop).result(120)

    def call(self, function: Any, *args: Any, **kwargs: Any) -> Any:
        """Call a function in the loop's thread and return its result."""

        async def wait() -> Any:
            return function(*args, **kwargs)

        return asyncio.run_coroutine_threadsafe(wait(), self.loop).result(120)

    def stop(self) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()


class Awaited:
    """Wraps an object of the asyncio client so that it is used like the blocking one."""

    def __init__(self, loop: EventLoop, target: Any) -> None:
        self._loop, self._target = loop, target

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._target, name)
        if name in PROPERTIES:
            return self._face(self._loop.run(value()))
        return self._method(value) if callable(value) else self._face(value)

    def _method(self, function: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            result = self._loop.call(function, *args, **kwargs)
            return self._face(self._loop.run(result) if inspect.isawaitable(result) else result)

        return call

    def _face(self, value: Any) -> Any:
        ours = type(value).__module__.startswith("cm.client.aio") or hasattr(value, "__aenter__")
        return Awaited(self._loop, value) if ours else value

    def __setattr__(self, name: str, value: Any) -> None:
        if name.startswith("_"):
            object.__setattr__(self, name, value)
        else:
            setattr(self._target, name, value)

    def __getitem__(self, key: Any) -> Any:
        return self._face(self._target[key])

    def __iter__(self) -> Iterator[Any]:
        items = self._target.__aiter__()
        while True:
            yield self._face(self._loop.run(items.__anext__()))

    def __next__(self) -> Any:
        return self._face(self._loop.run(self._target.__anext__()))

    def __enter__(self) -> Any:
        return self._face(self._loop.run(self._target.__aenter__()))

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> Any:
        return self._loop.run(self._target.__aexit__(kind, error, tb))

    def __repr__(self) -> str:
        return repr(self._target)


@contextmanager
def connected(kind: str, *args: Any, **kwargs: Any) -> Iterator[Any]:
    """A board by the client of that kind: ``blocking`` or ``asyncio``."""
    if kind == "blocking":
        with cm.connect(*args, **kwargs) as board:
            yield board
        return
    loop = EventLoop()
    try:
        made = loop.call(cm.aio.connect, *args, **kwargs)
        with Awaited(loop, made) as board:
            yield board
    finally:
        loop.stop()
