# SPDX-License-Identifier: Apache-2.0
"""A thread for allocating and freeing large memory: tens of MiB take tens of milliseconds."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from cm.server.loop import Loop

_T = TypeVar("_T")


class MemoryThread:
    """Does one task after another. Its methods are for the loop's thread."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._thread = ThreadPoolExecutor(1, "cm-memory")

    def run(self, work: Callable[[], _T], then: Callable[[Future[_T]], object] = lambda _: None) -> None:
        """Queue `work`, and pass its outcome to `then` in the loop's thread."""
        future = self._thread.submit(work)
        future.add_done_callback(lambda done: self._loop.call_threadsafe(lambda: then(done)))

    def close(self) -> None:
        """Wait until all queued work is done."""
        self._thread.shutdown()
