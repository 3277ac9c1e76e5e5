# SPDX-License-Identifier: Apache-2.0
"""Takes the steps of a plan, recording each before it is taken.

A step that fails leaves the board where the record says; going back is another plan, made from that
state (`cm.manager.execution.rollback`), not a list of inverses: so the way back copes with whatever was reached.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cm.manager.execution.actions import ACTIONS, Execution
from cm.manager.execution.board import Board, Tools
from cm.manager.planning.plan import Plan
from cm.manager.state.steps import Step


class Transaction:
    """One run through a plan."""

    def __init__(self, plan: Plan, board: Board, tools: Tools, number: int, cancelled: Callable[[], bool]) -> None:
        self._run = Execution(plan, board, tools, number, cancelled)
        self.current: Step | None = None

    @property
    def found(self) -> Mapping[str, int]:
        """Values that registers had before they were written, for the way back."""
        return self._run.found

    def run(self) -> None:
        """Take all steps. Raises what the failing step raised; `current` is that step."""
        for at, step in enumerate(self._run.plan.steps):
            self._run.at, self.current = at, step
            self._take(step)
        self.current = None

    def _take(self, step: Step) -> None:
        run, clock = self._run, self._run.tools.clock
        started, run.port_seconds = clock.monotonic(), 0.0
        run.board.record(step)
        run.tell(0)
        ACTIONS[type(step)](run, step)
        run.board.took(step, clock.monotonic() - started - run.port_seconds)
