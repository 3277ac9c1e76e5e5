# SPDX-License-Identifier: Apache-2.0
"""The daemon's event loop: ZeroMQ sockets, device descriptors, timers, and calls from other threads.

One thread. One socket, that of requests, is waited for by `zmq_poll`, which looks at its state before
and after; all else by an epoll that `zmq_poll` waits for as well. That is half the cost per message of
a `zmq.Poller` with all of them (docs/performance.md). Callbacks must not block.

A ZeroMQ socket's descriptor only says that something changed since the socket was last used in any
way, sending included (zmq_getsockopt(3), ZMQ_FD). So a socket behind the epoll is looked at until it has
nothing more, and again after everything that was sent on it from elsewhere: by `Loop.send`.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import Any, TypeVar

import zmq
from zmq.backend import zmq_poll

from cm import multipart

_LOG = logging.getLogger(__name__)
_T = TypeVar("_T")
Callback = Callable[[], None]
_POLLIN = int(zmq.POLLIN)  # arithmetic on the enumeration costs more than the call
_TURNS = 16  # requests that one socket may have served before others get their turn


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


@dataclass(frozen=True, slots=True, eq=False)
class _Watched:
    """A ZeroMQ socket, and what takes one message off it."""

    sources: list[tuple[Any, int]]  # the socket, as `zmq_poll` takes it
    take: Callback


class Loop:
    """Runs in the thread that calls `run()`. Everything but `call_threadsafe` and `ask` belongs to that thread."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._callbacks: dict[int, Callback] = {}
        self._sockets: dict[zmq.Socket[bytes], _Watched] = {}
        self._waited: list[tuple[Any, int]] = [(self._epoll.fileno(), _POLLIN)]  # as `zmq_poll` takes it
        self._takes: dict[Any, Callback] = {self._epoll.fileno(): self._serve_epoll}  # of what is waited for
        self._unlooked: set[_Watched] = set()  # may have messages that their descriptors do not tell of
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

    def add(self, fd: int, callback: Callback) -> None:
        """Call back whenever a descriptor is readable."""
        self._callbacks[fd] = callback
        self._epoll.register(fd, select.EPOLLIN)

    def remove(self, fd: int) -> None:
        """Stop watching; fine if it was not watched. To be called before the descriptor is closed."""
        if self._callbacks.pop(fd, None) is not None:
            with suppress(OSError):  # closed already
                self._epoll.unregister(fd)

    def add_socket(self, socket: zmq.Socket[bytes], take: Callback, foremost: bool = False) -> None:
        """Have `take` called when there are messages; it takes one, or more, off the socket.

        A `foremost` one costs less per message of its own, and a little with every other event.
        """
        if foremost:
            self._waited.append((socket, _POLLIN))
            self._takes[socket] = take
            return
        watched = self._sockets[socket] = _Watched([(socket, _POLLIN)], take)
        self.add(socket.fileno(), partial(self._look, watched))
        self._unlooked.add(watched)

    def send(self, socket: zmq.Socket[bytes], frames: Sequence[bytes | memoryview], flags: int = 0) -> None:
        """Send on a socket that is watched; the loop looks at it again before it waits."""
        watched = self._sockets.get(socket)
        if watched is not None:
            self._unlooked.add(watched)
        multipart.send(socket, frames, flags)

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
                wait = self._run_timers()
                for source, _ in zmq_poll(self._waited, 0 if self._unlooked else wait):
                    self._guarded(self._takes[source])
                if self._calls:
                    self._run_calls()
                if self._unlooked:
                    self._look_again()
        finally:
            self._run_calls()
            self._thread = None

    def close(self) -> None:
        """Release the descriptors."""
        self._epoll.close()
        os.close(self._wake)

    def _serve_epoll(self) -> None:
        for fd, _ in self._epoll.poll(0):
            callback = self._callbacks.get(fd)
            if callback is not None:
                self._guarded(callback)

    def _look(self, watched: _Watched) -> None:
        """Serve a socket until it has nothing more, or for its share."""
        for _ in range(_TURNS):
            if not zmq_poll(watched.sources, 0):  # half the time of asking for ZMQ_EVENTS
                self._unlooked.discard(watched)
                return
            self._guarded(watched.take)
        self._unlooked.add(watched)

    def _look_again(self) -> None:
        for watched in tuple(self._unlooked):
            self._look(watched)

    def _drain_wake(self) -> None:
        try:
            os.eventfd_read(self._wake)
        except BlockingIOError:
            return

    def _run_calls(self) -> None:
        while self._calls:
            self._guarded(self._calls.popleft())

    def _run_timers(self) -> int:
        """Make the calls that are due; milliseconds to the next, -1 without one."""
        timers, now = self._timers, time.monotonic()
        while timers and timers[0][0] <= now:
            timer = heapq.heappop(timers)[2]
            if timer.call is not None:
                self._guarded(timer.call)
        return max(0, ceil((timers[0][0] - now) * 1000)) if timers else -1

    def _guarded(self, call: Callback) -> None:
        """A defect in one callback must not end the daemon."""
        try:
            call()
        except Exception:  # noqa: BLE001 (logged; see above)
            _LOG.exception("a callback failed")
