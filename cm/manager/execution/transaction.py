# SPDX-License-Identifier: Apache-2.0
"""The execution of a plan: what its steps work with, how far it is, and each step recorded before it is taken.

A step that fails leaves the board where the record says. Going back is another plan, made from that state
(`cm.manager.execution.rollback`), not a list of inverses: so the way back works from whatever state was reached.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from cm.manager.access.register_bus import RegisterBus
from cm.manager.errors import Cancelled, NoPort, RecordFailed
from cm.manager.interfaces import DataPlane, Devices, Files, TimeSource
from cm.manager.loaders import Loaders, resolved
from cm.manager.planning.goals import Goal, Plan, image_bytes
from cm.manager.planning.planner import make_plan
from cm.manager.reporting import StatusReporter
from cm.manager.state import steps as s
from cm.manager.state.board_state import ManagerState
from cm.manager.state.steps import Step
from cm.manager.state.table import BoardState, RegionEvent, RegionState
from cm.schema.model import Config
from cm.wire.messages.status import Progress


@dataclass(frozen=True, slots=True)
class Tools:
    """What the steps of a change work with."""

    state: ManagerState
    reporter: StatusReporter
    devices: Devices
    registers: RegisterBus
    loaders: Loaders
    files: Files
    data_plane: DataPlane
    time: TimeSource


@dataclass(slots=True)
class StepContext:
    """A plan under execution: its tools, and how far it is.

    `best_effort` is for the way back, which continues even if its record cannot be written. The last good record then
    is of this change: after a crash the board goes to the same mode, and everything is loaded that this record does
    not say is there. Only a full image is not begun without a record, because registers of a half-loaded device must
    not be accessed.
    """

    plan: Plan
    tools: Tools
    number: int
    cancelled: Callable[[], bool]
    best_effort: bool = False
    at: int = -1  # index of the step that is being taken
    port_seconds: float = 0.0  # that a port took for that step's image
    written: dict[str, int] = field(default_factory=dict)  # registers, by name
    found: dict[s.Place, int] = field(default_factory=dict)  # what registers held before, for the way back
    sealed: set[str] = field(default_factory=set)  # regions that are certainly isolated
    begun: set[str] = field(default_factory=set)  # regions whose load has begun
    apart: set[str] = field(default_factory=set)  # regions of unknown content that were isolated before
    rates: dict[str, int] = field(default_factory=dict)  # what clocks ran at before, in Hz, for the way back

    @property
    def step(self) -> s.Step | None:
        """The step that is being taken; None before the first."""
        return self.plan.steps[self.at] if self.at >= 0 else None

    @property
    def board(self) -> BoardState:
        """What the board holds now."""
        return self.tools.state.board

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace what the board holds by what `change` makes of it, in one piece."""
        self.tools.state.update(change)

    def set_region(self, name: str, region: RegionState) -> None:
        """Replace a region's state."""
        self.update(lambda board: board.with_region(name, region))

    def region_event(self, name: str, event: RegionEvent) -> None:
        """Something happened to a region. Raises IllegalTransition."""
        self.set_region(name, self.board.region(name).after(event))

    def record(self, step: s.Step | None) -> None:
        """Write what the board holds, and the step about to be taken. Raises RecordFailed."""
        try:
            self.tools.state.record(step)
        except RecordFailed:
            if not self.best_effort or isinstance(step, s.LoadStatic):
                raise

    def check_cancelled(self) -> None:
        """Raise Cancelled if a client asked for it."""
        if self.cancelled():
            raise Cancelled("the change was cancelled")

    def tell(self, done: int) -> None:
        """Publish the step under way; `done` bytes of its image have gone through the port."""
        step, goal = self.plan.steps[self.at], self.plan.goal
        fraction = min(self._fraction(done), 1.0)
        length = image_bytes(step)
        self.tools.reporter.progress(
            Progress(self.number, goal.config.name, goal.mode, step.kind, step.subject, done, length, fraction)
        )

    def _fraction(self, done: int) -> float:
        before, whole = self.plan.steps[: self.at], self.plan.bytes
        return (sum(map(image_bytes, before)) + done) / whole if whole else self.at / len(self.plan.steps)


def plan_to(goal: Goal, tools: Tools) -> Plan:
    """The plan from here to a goal; touches nothing. Raises what is wrong with the files, and NoPort."""
    state = tools.state
    mode = goal.config.modes[goal.mode]
    wanted = {goal.config.modules[name].region for name in (*mode.modules, *goal.also)}
    try:
        config, choices = resolved(goal.config, wanted, tools.devices)
    except NoPort:
        plan = _plan(goal, resolved(goal.config, (), tools.devices)[0], tools)
        if not plan.then:  # otherwise the port may come with the overlays at its beginning
            raise
        return replace(plan, ports_later=True)
    state.choose(goal.config.name, choices)
    return _plan(goal, config, tools)


def _plan(goal: Goal, config: Config, tools: Tools) -> Plan:
    state = tools.state
    old = state.configs.get(state.board.config or "")
    return make_plan(replace(goal, config=config), state.board, old, tools.files, state.throughput, tools.devices)


Actions = Mapping[type, Callable[[StepContext, Any], None]]


def take_steps(run: StepContext, goal: Goal, actions: Actions) -> None:
    """Record each step, then take it by its action.

    Raises what a step raised; `run.step` is that step. A plan that only adds the devices of the static part is followed
    by the one that they make possible.
    """
    _take_all(run, actions)
    if run.plan.then:
        run.at = -1
        run.plan = plan_to(replace(goal, grounded=True), run.tools)
        _take_all(run, actions)


def _take_all(run: StepContext, actions: Actions) -> None:
    for at, step in enumerate(run.plan.steps):
        run.at = at
        _take(run, step, actions[type(step)])


def _take(run: StepContext, step: Step, action: Callable[[StepContext, Any], None]) -> None:
    time = run.tools.time
    started, run.port_seconds = time.monotonic(), 0.0
    run.record(step)
    run.tell(0)
    action(run, step)
    run.tools.state.took(step.kind, time.monotonic() - started, run.port_seconds)
