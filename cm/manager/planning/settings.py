# SPDX-License-Identifier: Apache-2.0
"""What a mode sets beside its modules: overlays, registers, clocks; and which of these a change has to set."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from cm.manager.errors import ClockRate
from cm.manager.interfaces import Devices, Files, Image, PlClock
from cm.manager.planning.goals import Goal
from cm.manager.state.clock_step import SetClock, hertz
from cm.manager.state.steps import ApplyOverlay, Place, SetRegister
from cm.manager.state.table import BoardState, OverlayState, RegionPhase, loading_overlay
from cm.schema.model import Access, Clock, Config, Mode, Register


@dataclass(frozen=True, slots=True)
class OverlayChange:
    """Names to remove, newest first, and overlays to apply, in their order."""

    removed: tuple[str, ...]
    applied: tuple[ApplyOverlay, ...]

    def __bool__(self) -> bool:
        return bool(self.removed or self.applied)


def overlay_change(
    state: BoardState, wanted: Sequence[ApplyOverlay], changed: Collection[str], everything: bool
) -> OverlayChange:
    """From the overlays that are applied to those that are wanted.

    `changed` are the regions that are loaded; with `everything` (a whole image) no overlay stays.
    """
    hashes = {step.overlay.name: step.sha256 for step in wanted}
    loading = {loading_overlay(name): name in changed for name in {*state.regions, *changed}}
    kept = set() if everything else _kept(state.overlays, hashes, loading)
    removed = tuple(o.name for o in reversed(state.overlays) if o.name not in kept)
    return OverlayChange(removed, tuple(w for w in wanted if w.overlay.name not in kept))


def wanted_overlays(config: Config, mode: Mode, files: Files, images: Sequence[Image]) -> list[ApplyOverlay]:
    """Those of a mode, in whose device `images` are. Raises what is wrong with the files."""
    named = {overlay.name: overlay for overlay in (*config.overlays, *mode.overlays)}
    data = [(overlay, files.overlay(config, overlay, images)) for overlay in named.values()]
    return [ApplyOverlay(overlay, blob, hashlib.sha256(blob).hexdigest()) for overlay, blob in data]


def _kept(applied: Collection[OverlayState], hashes: Mapping[str, str], loading: Mapping[str, bool]) -> set[str]:
    """Names of the overlays that stay.

    Overlays form a stack: to remove one, those applied after it are removed first, as they may depend on its nodes
    and the kernel would refuse. Only those by which other regions were loaded stay: each targets its own region's
    node, and the region's devices would go with it.
    """
    kept: set[str] = set()
    intact = True
    for held in applied:
        stays = not loading[held.name] if held.name in loading else hashes.get(held.name) == held.sha256
        if stays and (intact or held.name in loading):
            kept.add(held.name)
        else:
            intact = False
    return kept


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
        """Writes of registers whose region was reset, or whose value differs from what was written."""
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
    """The place of a register, whatever its name."""
    return register.address, register.width


def clock_steps(goal: Goal, state: BoardState, devices: Devices) -> tuple[SetClock, ...]:
    """The clocks that do not run as the goal wants them, or whose rate is not known.

    Raises ClockRate where a clock cannot come near enough to its rate, DeviceNotFound if the board has clocks, but
    none of that name.
    """
    if not (goal.config.clocks or goal.rates):
        return ()
    clocks = devices.clocks()
    if not clocks.names():  # as it always was there: their rates are not known, which is said once
        unset = (SetClock(clock, 0, None, running=True) for clock in goal.config.clocks.values())
        return tuple(step for step in unset if state.clocks.get(step.clock.name) != 0)
    steps = [_step(clocks.find(name), Clock(name, rate), restores=True) for name, rate in goal.rates.items()]
    named = [clock for clock in goal.config.clocks.values() if clock.name not in goal.rates]
    steps += [_step(clocks.find(clock.name), clock) for clock in named]
    return tuple(step for step in steps if goal.force or _is_due(step, state))


def _step(clock: PlClock, wanted: Clock, restores: bool = False) -> SetClock:
    achieved = clock.rounded(wanted.rate)
    if achieved is not None and not restores:
        check_rate(wanted, achieved)
    return SetClock(wanted, clock.rate, achieved, clock.enabled, restores)


def _is_due(step: SetClock, state: BoardState) -> bool:
    if state.clocks.get(step.clock.name) != step.before or not step.running:
        return True
    if step.achieved is not None:
        return step.before != step.achieved
    return abs(step.before - step.clock.rate) > allowed(step.clock)


def check_rate(clock: Clock, rate: int) -> None:
    """Raise ClockRate if a rate is further from what is wanted than the schema allows."""
    if abs(rate - clock.rate) > allowed(clock):
        raise ClockRate(
            f"clock {clock.name} would run at {hertz(rate)} and {hertz(clock.rate)} is wanted, which is off by "
            f"{100 * abs(rate - clock.rate) / clock.rate:.2g} %; {clock.tolerance:g} % is allowed (`tolerance`)"
        )


def allowed(clock: Clock) -> float:
    """Hz by which the clock may be off; 1 Hz at least, because rates are whole numbers."""
    return max(1.0, clock.rate * clock.tolerance / 100)
