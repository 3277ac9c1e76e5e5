# SPDX-License-Identifier: Apache-2.0
"""The daemon's own work in several steps: one in each turn of the loop, which serves requests in between."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from cm.daemon.loop import Loop


class BackgroundSteps:
    """Runs iterators that do one step per `next`; one of them takes one step per turn. Used in the loop's thread."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._waiting: deque[Iterator[None]] = deque()

    def run(self, steps: Iterator[None]) -> None:
        """Take the steps, the first no earlier than in the next turn."""
        self._waiting.append(steps)
        if len(self._waiting) == 1:
            self._loop.call_soon(self._step)

    def _step(self) -> None:
        steps = self._waiting[0]  # it stays in the queue meanwhile, so that `run` does not schedule a second turn
        ended = True
        try:
            ended = next(steps, steps) is not None
        finally:
            self._waiting.popleft()
            if not ended:
                self._waiting.append(steps)
            if self._waiting:
                self._loop.call_soon(self._step)
