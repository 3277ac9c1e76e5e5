# SPDX-License-Identifier: Apache-2.0
"""Threads that answer requests: so many at a time, and none that is waited for at the end."""

from __future__ import annotations

import threading
from collections.abc import Callable

_LOOK = 0.1  # seconds between two looks whether all is over, while as many requests run as may


class Workers:
    """Each request has a thread of its own, since its answer may take long; `most` run at a time."""

    def __init__(self, most: int) -> None:
        self._busy = threading.BoundedSemaphore(most)
        self._door = threading.Lock()
        self.closed = False

    def start(self, name: str, work: Callable[[], None]) -> None:
        """Begin `work` when it is its turn; never, where all is over by then."""
        while not self._busy.acquire(timeout=_LOOK):
            if self.closed:
                return
        threading.Thread(target=self._run, args=(work,), name=name, daemon=True).start()

    def _run(self, work: Callable[[], None]) -> None:
        try:
            work()
        finally:
            self._busy.release()

    def send(self, reply: Callable[[], None]) -> None:
        """Do what uses the middleware, one thread at a time; nothing once all is over.

        A thread that is inside zenoh's library when the interpreter ends aborts the whole process.
        """
        with self._door:
            if not self.closed:
                reply()

    def close(self) -> None:
        """Wait for the reply that is being sent, and send none any more; twice is fine."""
        with self._door:
            self.closed = True
