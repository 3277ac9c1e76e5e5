# SPDX-License-Identifier: Apache-2.0
"""The step of a change that sets a clock."""

from __future__ import annotations

from dataclasses import dataclass

from cm.schema.model import Clock


@dataclass(frozen=True, slots=True)
class SetClock:
    """Set a clock and read it back."""

    clock: Clock  # with the rate that is wanted
    before: int  # Hz; 0: no driver of this board can set clocks
    achieved: int | None  # Hz that it will run at; None where that cannot be known beforehand
    running: bool
    restores: bool = False  # on the way back: as near as it can be had is right
    kind = "clock"

    @property
    def subject(self) -> str:
        return self.clock.name

    @property
    def text(self) -> str:
        if not self.before:
            return f"leave clock {self.clock.name} as it is: {hertz(self.clock.rate)} is wanted, no driver here sets it"
        will = f", which makes {hertz(self.achieved)}" if self.achieved not in (None, self.clock.rate) else ""
        return f"set clock {self.clock.name} to {hertz(self.clock.rate)}{will} (now {hertz(self.before)})"


def hertz(rate: int | None) -> str:
    """A rate for people, to the Hz."""
    if rate is None:
        return "an unknown rate"
    return f"{rate / 1e6:.6f}".rstrip("0").rstrip(".") + " MHz"
