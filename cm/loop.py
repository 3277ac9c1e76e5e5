# SPDX-License-Identifier: Apache-2.0
"""An event loop: descriptors, timers, and calls, from this thread or another. One thread; callbacks do not block.

The simulated board runs on it as it is; the daemon adds ZeroMQ's sockets (`cm.server.sockets`). Why it is not
asyncio's, and what each costs: docs/decisions/own-event-loop.md.

Descriptors that were registered as listeners are served after all others of the same round. A client that
closes a node and opens it again is thus always seen to close it first: the close happened before the
connect, so either both are ready in one round, or the close alone.
"""

from __future__ import annotations

import heapq
import itertools
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotInTime  # the built-in one from Python 3.11 on
from contextlib import suppress
from math import ceil
from typing import TypeVar

_T = TypeVar("_T")
Callback = Callable[[], object]


class Timer:
    """A call at a time; `cancel()` makes it not happen."""

    __slots__ = ("callback",)

    def __init__(self, callback: Callback) -> None:
        self.callback: Callback | None = callback

    def cancel(self) -> None:
        """Forget the call; harmless when it was made already."""
        self.callback = None


class Loop:
    """Runs once, in the thread that calls `run()`; only `call_threadsafe`, `ask` and `stop` are for others."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._readers: dict[int, Callback] = {}
        self._writers: dict[int, Callback] = {}
        self._listeners: set[int] = set()
        self._timers: list[tuple[float, int, Timer]] = []
        self._order = itertools.count()  # timers of the same time are served as they were set
        self._calls: deque[Callback] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._waking = threading.RLock()  # held while it is written to or closed; a signal handler may interrupt
        self._is_closed = False
        self._woken = False
        self._thread: int | None = None
        self._stopping = False
        self.add(self._wake, self._drain_wake)

    # ---- any thread -------------------------------------------------------------

    def call_threadsafe(self, callback: Callback) -> None:
        """Call in the loop's thread, soon."""
        self._calls.append(callback)
        if not self._woken:  # else it has not looked yet
            self._woken = True
            self._wake_up()

    def ask(self, call: Callable[[], _T], timeout: float = 10.0) -> _T:
        """Call in the loop's thread and return what that returned, or raise what it raised.

        The call is direct if this is that thread, or if the loop does not run yet. Raises TimeoutError.
        """
        if self._thread in (None, threading.get_ident()):
            return call()
        answer = Future[_T]()
        self.call_threadsafe(lambda: _fulfil(answer, call))
        try:
            return answer.result(timeout)
        except NotInTime:
            if answer.done():  # the call itself raised it, or ended just now
                return answer.result()
            raise TimeoutError(f"the event loop did not answer within {timeout:.0f} s") from None

    def stop(self) -> None:
        """Make `run()` return after the present round; from any thread or a signal handler; harmless once closed."""
        self._stopping = True
        self._wake_up()

    def _wake_up(self) -> None:
        """Another thread may have ended and closed the loop meanwhile, and the descriptor may be someone else's."""
        with self._waking:
            if not self._is_closed:
                os.eventfd_write(self._wake, 1)

    # ---- the loop's thread --------------------------------------------------------

    def add(self, fd: int, on_readable: Callback, listener: bool = False) -> None:
        """Call `on_readable` whenever `fd` can be read or its peer has gone."""
        self._readers[fd] = on_readable
        if listener:
            self._listeners.add(fd)
        self._epoll.register(fd, select.EPOLLIN)

    def watch_write(self, fd: int, on_writable: Callback | None) -> None:
        """Call `on_writable` (and not the reader) until it is replaced by None."""
        if on_writable is None:
            self._writers.pop(fd, None)
            self._epoll.modify(fd, select.EPOLLIN)
        else:
            self._writers[fd] = on_writable
            self._epoll.modify(fd, select.EPOLLOUT)

    def pause(self, fd: int) -> None:
        """Until `resume`, call nothing for `fd` unless its peer has gone."""
        self._epoll.modify(fd, 0)

    def resume(self, fd: int) -> None:
        """Call the reader again."""
        self._epoll.modify(fd, select.EPOLLIN)

    def remove(self, fd: int) -> None:
        """Forget `fd`; fine if it was not watched. To be called before the descriptor is closed."""
        if self._readers.pop(fd, None) is None:
            return
        self._writers.pop(fd, None)
        self._listeners.discard(fd)
        with suppress(OSError):  # closed already
            self._epoll.unregister(fd)

    def call_soon(self, callback: Callback) -> None:
        """Call before the next wait."""
        self._calls.append(callback)

    def call_at(self, due: float, callback: Callback) -> Timer:
        """Call once at `due`, a time of `time.monotonic()`."""
        timer = Timer(callback)
        heapq.heappush(self._timers, (due, next(self._order), timer))
        return timer

    def call_later(self, seconds: float, callback: Callback) -> Timer:
        """Call once, `seconds` from now."""
        return self.call_at(time.monotonic() + seconds, callback)

    def every(self, seconds: float, callback: Callback) -> None:
        """Call repeatedly, until the loop ends."""

        def again() -> None:
            callback()
            self.call_later(seconds, again)

        self.call_later(seconds, again)

    def run(self) -> None:
        """Serve until `stop()`. Calls that other threads have asked for by then are still made."""
        self._thread = threading.get_ident()
        try:
            while not self._stopping:
                if self._calls:
                    self._run_calls()
                milliseconds = self._run_timers() if self._timers else -1
                if not self._stopping:  # a call above may have stopped us
                    self._wait(0 if self._calls else milliseconds)
        finally:
            self._run_calls()
            self._thread = None

    def close(self) -> None:
        """Release the descriptors; harmless when it was done already."""
        with self._waking:
            if not self._is_closed:
                self._is_closed = True
                self._epoll.close()
                os.close(self._wake)

    # ---- for loops that wait for more ----------------------------------------------

    def _wait(self, milliseconds: int) -> None:
        """Wait until a descriptor is ready, at most that long (-1: without limit), and serve those that are."""
        self._serve(milliseconds / 1000)

    def _failed(self, error: Exception) -> None:
        """A callback raised this; here, `run()` ends with it."""
        raise error

    def _serve(self, seconds: float) -> None:
        late = []
        for fd, events in self._epoll.poll(seconds):
            if fd in self._listeners:
                late.append(fd)
            else:
                self._ready(fd, events)
        for fd in late:
            self._ready(fd, select.EPOLLIN)

    def _ready(self, fd: int, events: int) -> None:
        callback = self._writers.get(fd)
        if callback is None:
            callback = self._readers.get(fd)
        elif not events & (select.EPOLLOUT | select.EPOLLHUP | select.EPOLLERR):
            return
        if callback is None:  # removed in this round
            return
        try:
            callback()
        except Exception as error:  # noqa: BLE001 (see _failed)
            self._failed(error)

    def _run_calls(self) -> None:
        for _ in range(len(self._calls)):  # not the calls that these add: others get their turn first
            self._guarded(self._calls.popleft())

    def _run_timers(self) -> int:
        """Make the calls that are due; returns the milliseconds until the next timer, -1 if there is none."""
        timers, started = self._timers, time.monotonic()
        now = started
        while timers and (timers[0][0] <= started or timers[0][2].callback is None):
            timer = heapq.heappop(timers)[2]
            if timer.callback is not None:
                self._guarded(timer.callback)
                now = time.monotonic()  # what the calls took is not waited for again
        return max(0, ceil((timers[0][0] - now) * 1000)) if timers else -1

    def _guarded(self, callback: Callback) -> None:
        try:
            callback()
        except Exception as error:  # noqa: BLE001 (see _failed)
            self._failed(error)

    def _drain_wake(self) -> None:
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        self._woken = False  # between reading and calling: a call is made now, or wakes the loop again


def _fulfil(answer: Future[_T], call: Callable[[], _T]) -> None:
    try:
        answer.set_result(call())
    except Exception as error:  # noqa: BLE001 (it is raised in the thread that asked)
        answer.set_exception(error)
