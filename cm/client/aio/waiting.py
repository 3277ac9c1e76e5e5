# SPDX-License-Identifier: Apache-2.0
"""Waiting for a descriptor in an event loop."""

from __future__ import annotations

import asyncio
from typing import Any, TypeVar

_T = TypeVar("_T")


class Waits:
    """Tasks that wait until a descriptor is readable, and those who close it send them away first."""

    def __init__(self) -> None:
        self._waiting: dict[asyncio.Future[None], int] = {}  # the descriptor of each

    async def readable(self, fd: int, limit: float | None) -> None:
        """Wait until a descriptor is readable, or is about to be closed. Raises asyncio.TimeoutError."""
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[None] = loop.create_future()
        self._waiting[ready] = fd
        loop.add_reader(fd, wake, ready)
        try:
            await within(ready, limit)
        finally:
            self._forget(ready)

    def end(self) -> None:
        """Their descriptors are about to be closed, of which an event loop says nothing."""
        for ready in tuple(self._waiting):
            self._forget(ready)
            wake(ready)

    def _forget(self, ready: asyncio.Future[None]) -> None:
        fd = self._waiting.pop(ready, None)
        if fd is not None:
            ready.get_loop().remove_reader(fd)


async def within(waiting: asyncio.Future[_T], limit: float | None) -> _T:
    """What `asyncio.wait_for` does, which loses a cancellation that comes with the result (before Python 3.12).

    In a notebook that is each interrupt: the event loop sees it with the next frame, or reply.
    """
    timer = None if limit is None else waiting.get_loop().call_later(limit, _over, waiting)
    try:
        return await waiting
    finally:
        if timer is not None:
            timer.cancel()


def _over(waiting: asyncio.Future[Any]) -> None:
    if not waiting.done():
        waiting.set_exception(asyncio.TimeoutError())


def wake(ready: asyncio.Future[None]) -> None:
    """Let the task go on that waits for a future; twice is fine."""
    if not ready.done():
        ready.set_result(None)
