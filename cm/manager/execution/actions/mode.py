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
from cm.manager.planning.registers import place_of
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
    if not step.restores:
        _note(run, register, step.value)
    if not _keeps_its_value(register):
        return
    value = run.tools.registers.read(register)
    if value != step.value:
        raise VerifyFailed(f"register {register.name} reads {value:#x} after {step.value:#x} was written")


def _note(run: StepContext, register: Register, value: int) -> None:
    """Until the end the names that are known are those of the configuration before, and its registers."""
    run.written[register.name] = value
    if run.board.config in (None, run.plan.goal.config.name):
        run.tools.state.note_written(register.name, value)
    else:
        run.update(lambda board: board.without_values(_names_before(run, register)))


def _names_before(run: StepContext, register: Register) -> set[str]:
    """What the configuration before calls a register."""
    config = run.tools.state.loaded_config()
    if config is None:
        return set()
    seen = (r for mode in config.modes for r in config.visible_registers(mode).values())
    return {r.name for r in seen if place_of(r) == place_of(register)}


def _remember(run: StepContext, register: Register) -> None:
    """What a register of the static part or of a region that stays held, where nobody wrote it yet."""
    if register.region in run.plan.regions or run.plan.full or not _keeps_its_value(register):
        return
    same = run.board.config == run.plan.goal.config.name
    names = {register.name} if same else _names_before(run, register)
    if any(run.tools.state.written_value(name) is not None for name in names) or place_of(register) in run.found:
        return
    value = run.tools.registers.read(register)
    run.found[place_of(register)] = value
    run.tools.state.note_found(place_of(register), value)
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
