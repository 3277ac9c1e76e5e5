# SPDX-License-Identifier: Apache-2.0
"""One run through a plan, as the actions of its steps see it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from cm.manager.errors import Cancelled
from cm.manager.execution.board import Board, Tools
from cm.manager.planning.plan import Plan, image_bytes
from cm.manager.state import steps as s
from cm.manager.state.table import RegionEvent, RegionState
from cm.messages.status import Progress


@dataclass(slots=True)
class Execution:
    """A plan, what it is carried out on and with, and how far it is."""

    plan: Plan
    board: Board
    tools: Tools
    number: int
    cancelled: Callable[[], bool]
    at: int = 0  # index of the step that is being taken
    port_seconds: float = 0.0  # that a port has taken for that step's image
    written: dict[str, int] = field(default_factory=dict)  # registers, by name
    found: dict[str, int] = field(default_factory=dict)  # what registers held before, for the way back

    @property
    def step(self) -> s.Step:
        """The step that is being taken."""
        return self.plan.steps[self.at]

    def set_region(self, name: str, region: RegionState) -> None:
        """Put a region's state in place of the one before."""
        self.board.update(lambda state: state.with_region(name, region))

    def region_event(self, name: str, event: RegionEvent) -> None:
        """Something happened to a region. Raises IllegalTransition."""
        self.set_region(name, self.board.state.region(name).after(event))

    def check_cancelled(self) -> None:
        """Raise Cancelled if somebody asked for it."""
        if self.cancelled():
            raise Cancelled("the change was cancelled")

    def tell(self, done: int) -> None:
        """Publish the step under way, of whose image `done` bytes have gone through the port."""
        step, goal = self.step, self.plan.goal
        fraction = min(self._fraction(done), 1.0)
        length = image_bytes(step)
        self.board.progress(
            Progress(self.number, goal.config.name, goal.mode, step.kind, step.subject, done, length, fraction)
        )

    def _fraction(self, done: int) -> float:
        before, whole = self.plan.steps[: self.at], self.plan.bytes
        return (sum(map(image_bytes, before)) + done) / whole if whole else self.at / len(self.plan.steps)
