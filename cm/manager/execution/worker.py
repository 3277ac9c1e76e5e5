# SPDX-License-Identifier: Apache-2.0
"""The thread that runs changes, one after the other."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from cm.manager.change import Change
from cm.manager.errors import ChangeBusy
from cm.messages.status import ErrorInfo

QUEUE_LENGTH = 8


class Worker:
    """Changes wait here for their turn; `run` is called with each.

    What it raises, or whoever waits for a change raises when told of its end, is a `defect` that those
    that come after must not suffer from.
    """

    def __init__(self, run: Callable[[Change], None], defect: Callable[[Exception], None]) -> None:
        self._run = run
        self._defect = defect
        self._queue: queue.Queue[Change | None] = queue.Queue(QUEUE_LENGTH)
        self._thread = threading.Thread(target=self._work, name="cm-changes", daemon=True)
        self._stopping = threading.Event()

    def start(self) -> None:
        """Begin with what waits."""
        self._thread.start()

    def stop(self) -> None:
        """End after the running change; those that wait are refused as cancelled."""
        self._stopping.set()
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def add(self, change: Change) -> Change:
        """Let a change wait for its turn. Raises ChangeBusy where too many do."""
        try:
            self._queue.put_nowait(change)
        except queue.Full:
            raise ChangeBusy(f"{QUEUE_LENGTH} changes wait already; try again when one has ended") from None
        return change

    def done(self) -> None:
        """The running change has ended as far as others can see; called by `run`."""
        self._queue.task_done()

    @property
    def busy(self) -> bool:
        """Whether a change runs or waits."""
        return self._queue.unfinished_tasks > 0

    @property
    def nothing_waits(self) -> bool:
        """Whether no change waits."""
        return self._queue.empty()

    def wait_idle(self) -> None:
        """Wait until no change runs or waits."""
        self._queue.join()

    def _work(self) -> None:
        while (change := self._queue.get()) is not None:
            try:
                self._turn(change)
            except Exception as problem:  # noqa: BLE001 (the thread has to live)
                self._defect(problem)
        self.done()

    def _turn(self, change: Change) -> None:
        if self._stopping.is_set():
            self.done()
            change.finish(ErrorInfo("cancelled", "the configuration manager is stopping"), 0.0)
        else:
            self._run(change)
