# SPDX-License-Identifier: Apache-2.0
"""Registers that a mode sets."""

from __future__ import annotations

from cm.manager.errors import VerifyFailed
from cm.manager.execution.actions.execution import Execution
from cm.manager.state import steps as s
from cm.schema.model import Access, Register


def write(run: Execution, step: s.SetRegister) -> None:
    """Write a register and, where it can be, read it back. Raises VerifyFailed."""
    register = step.register
    _remember(run, register)
    run.tools.registers.write_address(register.address, register.width, step.value)
    run.board.update(lambda state: state.with_value(register.name, step.value))
    run.written[register.name] = step.value
    if not _keeps_its_value(register):
        return
    value = run.tools.registers.read(register)
    if value != step.value:
        raise VerifyFailed(f"register {register.name} reads {value:#x} after {step.value:#x} was written")


def _remember(run: Execution, register: Register) -> None:
    """What a register of the static part or of a region that stays held, where nobody wrote it yet."""
    reset = register.region in run.plan.regions or run.plan.full
    known = register.name in run.board.state.values or reset
    if not known and _keeps_its_value(register):
        run.found[register.name] = run.tools.registers.read(register)


def _keeps_its_value(register: Register) -> bool:
    return register.access is Access.RW and not register.volatile
