# SPDX-License-Identifier: Apache-2.0
"""Threads of ours: zenoh's serve the network and must not wait, and none may be in its library at the end."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from cm.errors import CmError

_LOG = logging.getLogger("cm.rmw_zenoh")


class Inbox:
    """The last `depth` messages that came; older ones are lost, as with rmw_zenoh. Each is passed to `take`."""

    def __init__(self, name: str, depth: int, take: Callable[[Any], None]) -> None:
        self._take = take
        self._waiting: deque[Any] = deque(maxlen=depth)
        self._turn = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, thing: Any) -> None:
        """One more."""
        with self._turn:
            self._waiting.append(thing)
            self._turn.notify()

    def _run(self) -> None:
        while True:
            with self._turn:
                self._turn.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                thing = self._waiting.popleft()
            try:
                self._take(thing)
            except CmError as error:  # a failure with one message must not end the thread
                _LOG.warning("%s", error)
            except Exception:  # noqa: BLE001
                _LOG.exception("a message was not taken")

    def close(self) -> None:
        """End the thread, and wait for it; twice is fine."""
        with self._turn:
            self._closed = True
            self._turn.notify()
        if self._thread is not threading.current_thread():
            self._thread.join()


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
