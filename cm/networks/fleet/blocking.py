# SPDX-License-Identifier: Apache-2.0
"""The blocking client of a fleet: that of `cm.networks.fleet.aio` in a loop of its own."""

from __future__ import annotations

import asyncio
import functools
import threading
import weakref
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from cm.networks.fleet import aio
from cm.wire.messages.fleet import BoardStatus

_T = TypeVar("_T")
_P = ParamSpec("_P")


def _blocking(
    method: Callable[Concatenate[aio.Fleet, _P], Coroutine[Any, Any, _T]],
) -> Callable[Concatenate[Fleet, _P], _T]:
    """The same method, waited for."""

    def waited(self: Fleet, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        return self._wait(method(self._fleet, *args, **kwargs))

    functools.update_wrapper(waited, method)
    return waited


class Fleet:
    """Many boards, with calls that block. Groups of boards are names, globs (``line1-*``) and labels (``@camera``)."""

    def __init__(self, fleet: aio.Fleet) -> None:
        self._fleet, self._loop = fleet, asyncio.new_event_loop()
        thread = threading.Thread(target=self._loop.run_forever, name="cm-fleet", daemon=True)
        thread.start()
        self._end = weakref.finalize(self, _ended, self._loop, thread)
        try:
            self._wait(fleet.__aenter__())
        except BaseException:
            self._end()
            raise

    def _wait(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; twice is fine."""
        if self._end.alive:
            self._wait(self._fleet.close())
            self._end()

    @property
    def caller(self) -> str:
        """The name under which requests are made: each board's manager knows it as its guest ``zenoh:<name>``."""
        return self._fleet.caller

    boards = _blocking(aio.Fleet.boards)
    inventory = _blocking(aio.Fleet.inventory)
    chosen = _blocking(aio.Fleet.chosen)
    add = _blocking(aio.Fleet.add)
    remove = _blocking(aio.Fleet.remove)
    stored = _blocking(aio.Fleet.stored)
    status = _blocking(aio.Fleet.status)
    plan = _blocking(aio.Fleet.plan)
    read = _blocking(aio.Fleet.read)
    write = _blocking(aio.Fleet.write)
    frame = _blocking(aio.Fleet.frame)
    send = _blocking(aio.Fleet.send)
    load = _blocking(aio.Fleet.load)
    mode = _blocking(aio.Fleet.mode)
    reconcile = _blocking(aio.Fleet.reconcile)
    push = _blocking(aio.Fleet.push)

    @contextmanager
    def watch(self, boards: str = "*") -> Iterator[Iterator[tuple[str, BoardStatus | None]]]:
        """As that of `aio`: ``with fleet.watch() as statuses: for name, status in statuses: ...``."""
        context = self._fleet.watch(boards)
        statuses = self._wait(context.__aenter__())
        try:
            yield self._each(statuses)
        finally:
            self._wait(context.__aexit__(None, None, None))

    def _each(self, statuses: Any) -> Iterator[tuple[str, BoardStatus | None]]:
        while True:
            yield self._wait(anext(statuses))


def _ended(loop: asyncio.AbstractEventLoop, thread: threading.Thread) -> None:
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


def _connecting(connect: Callable[_P, aio.Fleet]) -> Callable[_P, Fleet]:
    @functools.wraps(connect)
    def connected(*args: _P.args, **kwargs: _P.kwargs) -> Fleet:
        return Fleet(connect(*args, **kwargs))

    return connected


connect = _connecting(aio.connect)
