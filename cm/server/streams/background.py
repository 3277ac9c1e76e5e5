# SPDX-License-Identifier: Apache-2.0
"""The daemon's own work in several steps: one in each turn of the loop, which serves requests in between."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from time import monotonic_ns
from typing import Protocol

from cm.server.loop import Loop
from cm.server.shares.bill import Payer


class Served(Protocol):
    """Who is served (`cm.server.shares.registry.Budgets`)."""

    @property
    def served(self) -> Payer | None:
        """Who pays for what is begun now; None: nobody."""


class BackgroundSteps:
    """Runs iterators that do one step per `next`; one of them takes one step per turn. Used in the loop's thread."""

    def __init__(self, loop: Loop, clients: Served) -> None:
        self._loop = loop
        self._clients = clients
        self._waiting: deque[tuple[Iterator[None], Payer | None]] = deque()

    def run(self, steps: Iterator[None], paid: bool = True) -> None:
        """Take the steps, the first no earlier than in the next turn; `paid`: by whoever is served now."""
        self._waiting.append((steps, self._clients.served if paid else None))
        if len(self._waiting) == 1:
            self._loop.call_soon(self._step)

    def _step(self) -> None:
        steps, payer = self._waiting[0]  # it stays in the queue, so that `run` does not schedule a second turn
        ended, began = True, monotonic_ns()
        try:
            ended = next(steps, steps) is not None
        finally:
            if payer is not None:
                payer.charge(monotonic_ns() - began)
            self._waiting.popleft()
            if not ended:
                self._waiting.append((steps, payer))
            if self._waiting:
                self._loop.call_soon(self._step)
