# SPDX-License-Identifier: Apache-2.0
"""Which registers a change writes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from cm.manager.planning.plan import Goal
from cm.manager.state.steps import SetRegister
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
        values = [(r, self.goal.values.get(r.name, r.default)) for r in visible if self._can_write(r)]
        return [SetRegister(r, value) for r, value in values if value is not None and self._is_due(r, value)]

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
        return register.region in self.reset or known != value or self.goal.force
