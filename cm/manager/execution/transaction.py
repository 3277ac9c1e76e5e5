# SPDX-License-Identifier: Apache-2.0
"""A change of mode: planned, its steps taken with each recorded before, and back where one fails.

A step that fails leaves the board where the record says. Going back is another plan, made from that state
(`cm.manager.execution.rollback`), not a list of inverses: so the way back copes with whatever was reached.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

from cm.manager.execution.actions import ACTIONS
from cm.manager.execution.context import StepContext, Tools
from cm.manager.execution.rollback import Failure, Rollback
from cm.manager.loaders.choice import resolved
from cm.manager.planning.plan import Goal, Plan
from cm.manager.planning.planner import make_plan
from cm.manager.state.steps import Step


def plan_to(goal: Goal, tools: Tools) -> Plan:
    """What going there would do from here; touches nothing. Raises what is wrong with the files."""
    state = tools.state
    mode = goal.config.modes[goal.mode]
    wanted = {goal.config.modules[name].region for name in (*mode.modules, *goal.also)}
    config, choices = resolved(goal.config, wanted, tools.devices)
    state.choose(goal.config.name, choices)
    goal = replace(goal, config=config)
    old = state.configs.get(state.board.config or "")
    return make_plan(goal, state.board, old, tools.files, state.throughput, tools.devices)


class Transaction:
    """Takes the board to a goal, or back to where it was."""

    def __init__(self, tools: Tools, number: int, cancelled: Callable[[], bool]) -> None:
        self._tools = tools
        self._number = number
        self._cancelled = cancelled

    def run(self, goal: Goal) -> None:
        """Go there, or back.

        Raises what the plan says is wrong (nothing was touched then), StepFailed (the board went back)
        or UndoFailed (regions stay decoupled).
        """
        before = self._tools.state.board
        run = StepContext(plan_to(goal, self._tools), self._tools, self._number, self._cancelled)
        try:
            _take_steps(run)
        except Exception as error:
            rollback = Rollback(self._tools, before, functools.partial(self._go_back, run.sealed), run.sealed)
            raise rollback.run(_failure(run, error)) from error  # in no variable: its traceback has this frame

    def _go_back(self, sealed: set[str], goal: Goal) -> None:
        plan = plan_to(goal, self._tools)
        _take_steps(StepContext(plan, self._tools, self._number, lambda: False, best_effort=True, sealed=sealed))


def _failure(run: StepContext, error: Exception) -> Failure:
    goal = run.plan.goal
    values, found, rates = goal.values, {**run.found, **goal.found}, {**run.rates, **goal.rates}
    return Failure(goal.config, run.step, error, values, found, rates, frozenset(run.begun | run.apart))


def _take_steps(run: StepContext) -> None:
    """Raises what the failing step raised; `run.step` is that step."""
    for at, step in enumerate(run.plan.steps):
        run.at = at
        _take(run, step)


def _take(run: StepContext, step: Step) -> None:
    clock = run.tools.clock
    started, run.port_seconds = clock.monotonic(), 0.0
    run.record(step)
    run.tell(0)
    ACTIONS[type(step)](run, step)
    run.tools.state.took(step.kind, clock.monotonic() - started - run.port_seconds)
