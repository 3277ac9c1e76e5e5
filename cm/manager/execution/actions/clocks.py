# SPDX-License-Identifier: Apache-2.0
"""Clocks of the processing system for the PL."""

from __future__ import annotations

from cm.manager.execution.transaction import StepContext
from cm.manager.planning.settings import check_rate
from cm.manager.state import steps as s


def set_clock(run: StepContext, step: s.SetClock) -> None:
    """Set a clock, keep it running, and read back its rate, since rates are rounded without an error.

    Raises ClockRate if that is not near enough, DeviceError.
    """
    name = step.clock.name
    if not step.before:
        run.update(lambda board: board.with_clock(name, 0))
        return
    clock = run.tools.devices.clocks().find(name)
    run.rates[name] = step.before
    if clock.rate != step.clock.rate:
        clock.rate = step.clock.rate
    if not step.running:
        clock.enabled = True
    rate = clock.rate
    run.update(lambda board: board.with_clock(name, rate))
    if not step.restores:
        check_rate(step.clock, rate)
