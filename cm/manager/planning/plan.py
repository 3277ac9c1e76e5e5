# SPDX-License-Identifier: Apache-2.0
"""Where to go, and the steps there: data. `cm.manager.planning.planner` makes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from cm.manager.state import steps as s
from cm.manager.state.cost import Throughput
from cm.messages.status import ClockStatus, PlanInfo, PlanStep
from cm.schema.model import Config, ConfigType


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go.

    `values` overrides registers' defaults: the way back restores what was written. `also` are modules
    beside the mode's, in regions that the mode leaves alone: the way back restores what they held.
    `static` is the full configuration whose image a partial one was running in, for the way back to it.
    `rates` are clocks' rates in Hz that the way back restores, whatever the configuration says of them; `found`
    likewise what registers held, by physical address and width, which no name of the configuration has to reach.
    """

    config: Config
    mode: str
    force: bool = False
    values: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    also: tuple[str, ...] = ()
    static: Config | None = None
    rates: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    found: Mapping[s.Place, int] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def base(self) -> Config | None:
        """The configuration whose image has to be in the device; None where that cannot be known."""
        return self.config if self.config.type is ConfigType.FULL else self.static


@dataclass(frozen=True, slots=True)
class Plan:
    """Steps from one state to a goal."""

    goal: Goal
    steps: tuple[s.Step, ...]
    full: bool = False

    @property
    def bytes(self) -> int:
        """Bytes that go through configuration ports."""
        return sum(map(image_bytes, self.steps))

    @property
    def regions(self) -> frozenset[str]:
        """The regions that are cut off for a while, or stand cut off."""
        return frozenset(step.region.name for step in self.steps if isinstance(step, s.Recouple))

    def info(self, throughput: Throughput) -> PlanInfo:
        """As it is shown."""
        rows = tuple(
            PlanStep(step.kind, step.subject, step.text, image_bytes(step), _seconds(step, throughput))
            for step in self.steps
        )
        seconds = sum(r.seconds for r in rows)
        clocks = tuple(ClockStatus(c.clock.name, c.clock.rate, c.achieved or 0) for c in self.clocks)
        return PlanInfo(self.goal.config.name, self.goal.mode, rows, self.bytes, seconds, clocks)

    @property
    def clocks(self) -> Iterator[s.SetClock]:
        """The clocks that are set."""
        return (step for step in self.steps if isinstance(step, s.SetClock))


def image_bytes(step: s.Step) -> int:
    """Bytes that a step sends through a configuration port."""
    return step.image.length if isinstance(step, s.Load | s.LoadStatic) else 0


def _seconds(step: s.Step, throughput: Throughput) -> float:
    beside = throughput.overhead(step.kind)
    if isinstance(step, s.Load | s.LoadStatic):
        return beside + throughput.seconds(step.port_kind, step.image.length)
    return beside
