# SPDX-License-Identifier: Apache-2.0
"""The daemon's event loop: ZeroMQ sockets, device descriptors, timers, and calls from other threads.

A plain `zmq.Poller` loop: one thread, about a third of asyncio's cost per message
(docs/performance.md). Callbacks must not block.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

import zmq

_LOG = logging.getLogger(__name__)
_T = TypeVar("_T")
Callback = Callable[[], None]


class LoopStopped(RuntimeError):
    """The loop ends, so a call handed to it will not be made."""


class Timer:
    """A pending call; `cancel()` forgets it."""

    __slots__ = ("call",)

    def __init__(self, call: Callback) -> None:
        self.call: Callback | None = call

    def cancel(self) -> None:
        """Do not call; twice is fine."""
        self.call = None


class Loop:
    """Runs in the thread that calls `run()`. Everything but `call_threadsafe` and `ask` belongs to that thread."""

    def __init__(self) -> None:
        self._poller = zmq.Poller()
        self._callbacks: dict[Any, Callback] = {}
        self._timers: list[tuple[float, int, Timer]] = []
        self._order = itertools.count()
        self._calls: deque[Callback] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._thread: int | None = None
        self._stopping = False
        self.add(self._wake, self._drain_wake)

    # ---- any thread -------------------------------------------------------------

    def call_threadsafe(self, call: Callback) -> None:
        """Make a call in the loop's thread, soon."""
        self._calls.append(call)
        os.eventfd_write(self._wake, 1)

    def ask(self, call: Callable[[], _T], timeout: float = 10.0) -> _T:
        """Make a call in the loop's thread and return what it returned or raise what it raised.

        Direct if this is that thread, or if the loop does not run yet. Raises TimeoutError.
        """
        if self._thread in (None, threading.get_ident()):
            return call()
        done = threading.Event()
        result: list[Any] = []

        def run() -> None:
            try:
                result[:] = [call(), None]
            except Exception as error:  # noqa: BLE001 (handed to the caller)
                result[:] = [None, error]
            done.set()

        self.call_threadsafe(run)
        if not done.wait(timeout):
            raise TimeoutError(f"the daemon's loop did not answer within {timeout:.0f} s")
        value, error = result
        if error is not None:
            raise error
        return value  # type: ignore[no-any-return]

    def stop(self) -> None:
        """End `run()`; from any thread or a signal handler."""
        self._stopping = True
        os.eventfd_write(self._wake, 1)

    # ---- the loop's thread --------------------------------------------------------

    def add(self, source: zmq.Socket[bytes] | int, callback: Callback) -> None:
        """Call back whenever a socket or descriptor is readable."""
        self._callbacks[source] = callback
        self._poller.register(source, zmq.POLLIN)

    def remove(self, source: zmq.Socket[bytes] | int) -> None:
        """Stop watching; fine if it was not watched."""
        if self._callbacks.pop(source, None) is not None:
            self._poller.unregister(source)

    def call_later(self, seconds: float, call: Callback) -> Timer:
        """Call once, `seconds` from now."""
        timer = Timer(call)
        heapq.heappush(self._timers, (time.monotonic() + seconds, next(self._order), timer))
        return timer

    def every(self, seconds: float, call: Callback) -> None:
        """Call again and again, until the loop ends."""

        def again() -> None:
            call()
            self.call_later(seconds, again)

        self.call_later(seconds, again)

    def run(self) -> None:
        """Serve until `stop()`."""
        self._thread = threading.get_ident()
        try:
            while not self._stopping:
                for source, _ in self._poller.poll(self._timeout()):
                    callback = self._callbacks.get(source)
                    if callback is not None:
                        self._guarded(callback)
                if self._calls:
                    self._run_calls()
                self._run_timers()
        finally:
            self._run_calls()
            self._thread = None

    def close(self) -> None:
        """Release the wake descriptor."""
        os.close(self._wake)

    def _drain_wake(self) -> None:
        try:
            os.eventfd_read(self._wake)
        except BlockingIOError:
            return

    def _run_calls(self) -> None:
        while self._calls:
            self._guarded(self._calls.popleft())

    def _timeout(self) -> int | None:
        """Milliseconds to the next timer; None without one."""
        while self._timers and self._timers[0][2].call is None:
            heapq.heappop(self._timers)
        if not self._timers:
            return None
        return max(0, int((self._timers[0][0] - time.monotonic()) * 1000) + 1)

    def _run_timers(self) -> None:
        now = time.monotonic()
        while self._timers and self._timers[0][0] <= now:
            timer = heapq.heappop(self._timers)[2]
            if timer.call is not None:
                self._guarded(timer.call)

    def _guarded(self, call: Callback) -> None:
        """A defect in one callback must not end the daemon."""
        try:
            call()
        except Exception:  # noqa: BLE001 (logged; see above)
            _LOG.exception("a callback failed")
