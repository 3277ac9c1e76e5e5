# SPDX-License-Identifier: Apache-2.0
"""What a mode is beside its modules: streams are stopped at the beginning, registers set, and the end is published."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from types import MappingProxyType

from cm.manager.errors import RecordFailed, VerifyFailed
from cm.manager.execution.actions.regions import job_of
from cm.manager.execution.context import StepContext
from cm.manager.planning.plan import Goal
from cm.manager.state import steps as s
from cm.manager.state.table import BoardState
from cm.schema.model import Access, Register


def validate(run: StepContext, _: s.Validate) -> None:
    """The planner has read and checked every image; what is left is to ask the ports, and to keep readers off."""
    for step in run.plan.steps:
        if isinstance(step, s.Load | s.LoadStatic):
            run.tools.loaders.kind(step.port_kind).check(job_of(run, step))
    run.tools.state.lock_regions(run.plan.regions, whole=run.plan.full)
    run.check_cancelled()


def quiesce(run: StepContext, step: s.Quiesce) -> None:
    """When this returns no transfer of these streams is under way."""
    run.tools.data_plane.quiesce(step.streams)


def set_register(run: StepContext, step: s.SetRegister) -> None:
    """Write a register and, where it can be, read it back. Raises VerifyFailed."""
    register = step.register
    _remember(run, register)
    run.tools.registers.write_address(register.address, register.width, step.value)
    run.tools.state.note_written(register.name, step.value)
    run.written[register.name] = step.value
    if not _keeps_its_value(register):
        return
    value = run.tools.registers.read(register)
    if value != step.value:
        raise VerifyFailed(f"register {register.name} reads {value:#x} after {step.value:#x} was written")


def _remember(run: StepContext, register: Register) -> None:
    """What a register of the static part or of a region that stays held, where nobody wrote it yet."""
    reset = register.region in run.plan.regions or run.plan.full
    known = reset or run.tools.state.written_value(register.name) is not None
    if not known and _keeps_its_value(register):
        value = run.tools.registers.read(register)
        run.found[register.name] = value
        run.tools.state.note_found(register.name, value)
        run.record(run.step)  # a kill between the write and the next step must not lose it


def _keeps_its_value(register: Register) -> bool:
    return register.access is Access.RW and not register.volatile


def publish(run: StepContext, step: s.Publish) -> None:
    """The board is in the mode: record it, let readers and streams in.

    A record that cannot be written now undoes nothing: the one before says that this change was nearly
    done, and after a crash the board goes back to the mode before. It is tried once more, and told, when
    the change has ended.
    """
    run.update(lambda state: _entered(state, run.plan.goal, run.written))
    with contextlib.suppress(RecordFailed):
        run.record(None)
    run.tools.state.release_regions()
    run.tools.data_plane.resume(run.plan.goal.config, step.mode)


def _entered(state: BoardState, goal: Goal, written: dict[str, int]) -> BoardState:
    """In another configuration the same names are other registers: only what was written here is known."""
    if state.config != goal.config.name:
        state = replace(state, values=MappingProxyType(dict(written)))
    return replace(state, config=goal.config.name, mode=goal.mode)
