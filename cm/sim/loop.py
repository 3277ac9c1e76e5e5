# SPDX-License-Identifier: Apache-2.0
"""A single-threaded event loop: descriptors, timers, and calls to make before the next wait.

Descriptors that were registered as listeners are served after all others of the same round.
A client that closes a node and opens it again is thus always seen to close it first: the close
happened before the connect, so both are ready in one round or the close alone.
"""

from __future__ import annotations

import heapq
import itertools
import select
import time
from collections import deque
from collections.abc import Callable

Callback = Callable[[], None]


class Timer:
    """A call at a time; `cancel()` makes it not happen."""

    __slots__ = ("callback", "due")

    def __init__(self, due: float, callback: Callback) -> None:
        self.due = due
        self.callback: Callback | None = callback

    def cancel(self) -> None:
        """Forget the call; harmless when it was made already."""
        self.callback = None


class Loop:
    """epoll, a heap of timers and a queue of calls."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._readers: dict[int, Callback] = {}
        self._writers: dict[int, Callback] = {}
        self._listeners: set[int] = set()
        self._timers: list[tuple[float, int, Timer]] = []
        self._soon: deque[Callback] = deque()
        self._count = itertools.count()
        self._running = False

    def add(self, fd: int, on_readable: Callback, listener: bool = False) -> None:
        """Call `on_readable` when `fd` can be read or its peer has gone."""
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
        """Call nothing for `fd` but at its peer's end, until `resume`."""
        self._epoll.modify(fd, 0)

    def resume(self, fd: int) -> None:
        """Call the reader again."""
        self._epoll.modify(fd, select.EPOLLIN)

    def remove(self, fd: int) -> None:
        """Forget `fd`; call it before the descriptor is closed."""
        if self._readers.pop(fd, None) is None:
            return
        self._writers.pop(fd, None)
        self._listeners.discard(fd)
        self._epoll.unregister(fd)

    def at(self, due: float, callback: Callback) -> Timer:
        """Call `callback` at `due`, a time of `time.monotonic()`."""
        timer = Timer(due, callback)
        heapq.heappush(self._timers, (due, next(self._count), timer))
        return timer

    def after(self, delay: float, callback: Callback) -> Timer:
        """Call `callback` in `delay` seconds."""
        return self.at(time.monotonic() + delay, callback)

    def soon(self, callback: Callback) -> None:
        """Call `callback` before the next wait."""
        self._soon.append(callback)

    def stop(self) -> None:
        """Make `run` return after the present round."""
        self._running = False

    def run(self) -> None:
        """Serve until `stop`."""
        self._running = True
        while self._running:
            self._run_soon()
            self._run_timers()
            self._wait()

    def close(self) -> None:
        """Release the epoll descriptor."""
        self._epoll.close()

    def _wait(self) -> None:
        if self._running:  # a call above may have stopped us
            self._dispatch(self._epoll.poll(self._timeout()))

    def _timeout(self) -> float:
        if self._soon:
            return 0.0
        while self._timers and self._timers[0][2].callback is None:
            heapq.heappop(self._timers)
        if not self._timers:
            return -1.0
        return max(0.0, self._timers[0][0] - time.monotonic())

    def _run_soon(self) -> None:
        for _ in range(len(self._soon)):
            self._soon.popleft()()

    def _run_timers(self) -> None:
        if not self._timers:
            return
        now = time.monotonic()
        while self._timers and self._timers[0][0] <= now:
            timer = heapq.heappop(self._timers)[2]
            if timer.callback is not None:
                timer.callback()

    def _dispatch(self, ready: list[tuple[int, int]]) -> None:
        late = []
        for fd, events in ready:
            if fd in self._listeners:
                late.append(fd)
            else:
                self._serve(fd, events)
        for fd in late:
            self._serve(fd, select.EPOLLIN)

    def _serve(self, fd: int, events: int) -> None:
        writer = self._writers.get(fd)
        if writer is not None:
            if events & (select.EPOLLOUT | select.EPOLLHUP | select.EPOLLERR):
                writer()
            return
        reader = self._readers.get(fd)
        if reader is not None:
            reader()
