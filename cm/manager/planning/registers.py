# SPDX-License-Identifier: Apache-2.0
"""Which registers a change writes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from cm.manager.planning.plan import Goal
from cm.manager.state.steps import Place, SetRegister
from cm.manager.state.table import BoardState, RegionPhase
from cm.schema.model import Access, Register


@dataclass(frozen=True, slots=True)
class Writing:
    """The registers of a goal against what was written last.

    `reset` are the regions whose registers have their reset values then: those that are loaded, and
    those that are recoupled (a static part may hold a region in reset while it is cut off).
    """

    goal: Goal
    state: BoardState
    reset: Collection[str]

    def steps(self) -> list[SetRegister]:
        """Where the region was reset, or where the value differs from what was written."""
        visible = self.goal.config.visible_registers(self.goal.mode).values()
        values = [(r, self._value(r)) for r in visible if self._can_write(r)]
        return [SetRegister(r, value) for r, value in values if value is not None and self._is_due(r, value)]

    def restored(self) -> list[SetRegister]:
        """What a failed change wrote to registers of the static part that this mode has no name for."""
        named = {place_of(r) for r in self.goal.config.visible_registers(self.goal.mode).values()}
        found = {place: value for place, value in self.goal.found.items() if place not in named}
        return [
            SetRegister(Register(f"at {address:#x}", address, 0, width), value, restores=True)
            for (address, width), value in found.items()
        ]

    def _value(self, register: Register) -> int | None:
        value = self.goal.values.get(register.name)
        return self.goal.found.get(place_of(register), register.default) if value is None else value

    def _can_write(self, register: Register) -> bool:
        return register.access not in (Access.RO, Access.W1C) and not self._nobody_answers(register)

    def _nobody_answers(self, register: Register) -> bool:
        """A region that this mode leaves alone may hold nothing; only what the mode itself sets is then an error."""
        region, mode = register.region, self.goal.config.modes[self.goal.mode]
        if region is None or region in self.reset or register.name in mode.registers:
            return False
        return self.state.region(region).phase is not RegionPhase.READY

    def _is_due(self, register: Register, value: int) -> bool:
        same_config = self.state.config == self.goal.config.name
        known = self.state.values.get(register.name) if same_config else None
        forced = self.goal.force or place_of(register) in self.goal.found
        return register.region in self.reset or known != value or forced


def place_of(register: Register) -> Place:
    """Where a register lies, whatever it is called."""
    return register.address, register.width
