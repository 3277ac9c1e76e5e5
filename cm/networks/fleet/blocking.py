# SPDX-License-Identifier: Apache-2.0
"""The blocking client of a fleet: that of `cm.networks.fleet.aio` in a loop of its own."""

from __future__ import annotations

import asyncio
import functools
import os
import threading
import weakref
from collections.abc import Callable, Coroutine, Iterable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from cm.networks.fleet import aio
from cm.wire.messages.fleet import BoardStatus

_T = TypeVar("_T")
_P = ParamSpec("_P")


class _Loop:
    """An event loop in a thread that ends with the process."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="cm-fleet", daemon=True)
        self._thread.start()

    def wait_for(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        future = asyncio.run_coroutine_threadsafe(coroutine, self.loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def end(self) -> None:
        """Twice is fine."""
        if not self.loop.is_closed():
            self.loop.call_soon_threadsafe(self.loop.stop)
            self._thread.join()
            self.loop.close()


def _blocking(
    method: Callable[Concatenate[aio.Fleet, _P], Coroutine[Any, Any, _T]],
) -> Callable[Concatenate[Fleet, _P], _T]:
    """The same method, waited for."""

    def waited(self: Fleet, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        return self._loop.wait_for(method(self._fleet, *args, **kwargs))

    functools.update_wrapper(waited, method)
    return waited


@functools.wraps(aio.connect)
def connect(
    router: str | Iterable[str] = (),
    *,
    config: str | os.PathLike[str] | None = None,
    caller: str = "",
    timeout: float = 10.0,
    store: str = "",
) -> Fleet:
    return Fleet(aio.connect(router, config=config, caller=caller, timeout=timeout, store=store))


class Fleet:
    """Many boards, with calls that block. Groups of boards are names, globs (``line1-*``) and labels (``@camera``)."""

    def __init__(self, fleet: aio.Fleet) -> None:
        self._loop = _Loop()
        self._fleet = fleet
        self._end = weakref.finalize(self, self._loop.end)
        try:
            self._loop.wait_for(fleet.__aenter__())
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; twice is fine."""
        if self._end.alive:
            self._loop.wait_for(self._fleet.close())
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
    move_store = _blocking(aio.Fleet.move_store)
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
        """Statuses of boards as they change, and each second; None when a board has gone. One name, or ``*``.

        ``with fleet.watch() as statuses: for name, status in statuses: ...``. If more than a thousand wait to be
        read, the oldest are lost.
        """
        context = self._fleet.watch(boards)
        statuses = self._loop.wait_for(context.__aenter__())
        try:
            yield self._each(statuses)
        finally:
            self._loop.wait_for(context.__aexit__(None, None, None))

    def _each(self, statuses: Any) -> Iterator[tuple[str, BoardStatus | None]]:
        while True:
            yield self._loop.wait_for(anext(statuses))
