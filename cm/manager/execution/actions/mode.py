# SPDX-License-Identifier: Apache-2.0
"""The beginning and the end of a change: ask the ports, stop the streams, publish the mode."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from types import MappingProxyType

from cm.manager.errors import RecordFailed
from cm.manager.execution.actions.execution import Execution
from cm.manager.execution.actions.regions import job_of
from cm.manager.planning.plan import Goal
from cm.manager.state import steps as s
from cm.manager.state.table import BoardState


def validate(run: Execution, _: s.Validate) -> None:
    """The planner has read and checked every image; what is left is to ask the ports, and to keep readers off."""
    for step in run.plan.steps:
        if isinstance(step, s.Load | s.LoadStatic):
            run.tools.loaders.kind(step.port_kind).check(job_of(run, step))
    run.board.lock_regions(run.plan.regions, whole=run.plan.full)
    run.check_cancelled()


def quiesce(run: Execution, step: s.Quiesce) -> None:
    """When this returns no transfer of these streams is under way."""
    run.tools.data_plane.quiesce(step.streams)


def publish(run: Execution, step: s.Publish) -> None:
    """The board is in the mode: record it, let readers and streams in.

    A record that cannot be written now undoes nothing: the one before says that this change was nearly
    done, and after a crash the board goes back to the mode before. It is tried once more, and told, when
    the change has ended.
    """
    run.board.update(lambda state: _entered(state, run.plan.goal, run.written))
    with contextlib.suppress(RecordFailed):
        run.board.record(None)
    run.board.lock_regions(frozenset())
    run.tools.data_plane.resume(run.plan.goal.config, step.mode)


def _entered(state: BoardState, goal: Goal, written: dict[str, int]) -> BoardState:
    """In another configuration the same names are other registers: only what was written here is known."""
    if state.config != goal.config.name:
        state = replace(state, values=MappingProxyType(dict(written)))
    return replace(state, config=goal.config.name, mode=goal.mode)
