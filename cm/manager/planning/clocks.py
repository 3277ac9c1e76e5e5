# SPDX-License-Identifier: Apache-2.0
"""Which clocks a change sets."""

from __future__ import annotations

from cm.manager.errors import ClockRate
from cm.manager.planning.plan import Goal
from cm.manager.ports import Devices, PlClock
from cm.manager.state.steps import SetClock, hertz
from cm.manager.state.table import BoardState
from cm.schema.model import Clock


def clock_steps(goal: Goal, state: BoardState, devices: Devices) -> tuple[SetClock, ...]:
    """The clocks that do not run as the goal wants them, or of which nobody knows.

    Raises ClockRate where a clock cannot come near enough to its rate, DeviceNotFound where there is none of
    that name beside others.
    """
    if not (goal.config.clocks or goal.rates):
        return ()
    clocks = devices.clocks()
    if not clocks.names():  # as it always was there: what they run at is not known, which is said once
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
