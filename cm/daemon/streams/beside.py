# SPDX-License-Identifier: Apache-2.0
"""Work of the daemon's own that takes several steps: one in each turn of the loop, which serves others in between."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from cm.daemon.loop import Loop


class Beside:
    """Runs iterators, which do a step with each `next`: one step of one of them in a turn. The loop's thread."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._waiting: deque[Iterator[None]] = deque()

    def run(self, steps: Iterator[None]) -> None:
        """Do the steps, the first in the next turn at the earliest."""
        self._waiting.append(steps)
        if len(self._waiting) == 1:
            self._loop.call_soon(self._step)

    def _step(self) -> None:
        steps = self._waiting[0]  # it stays there meanwhile, so that nobody else begins another round
        ended = True
        try:
            ended = next(steps, steps) is not None
        finally:
            self._waiting.popleft()
            if not ended:
                self._waiting.append(steps)
            if self._waiting:
                self._loop.call_soon(self._step)
