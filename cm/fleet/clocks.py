# SPDX-License-Identifier: Apache-2.0
"""How closely the clocks of several boards agree: by their own account, and as measured from here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cm.messages.fleet import ClockSync


@dataclass(frozen=True, slots=True)
class Reading:
    """A board's clock, as it says, and its offset from this machine's: between `low_ns` and `high_ns`.

    The board read its clock after it was asked and before its answer came: no more can be known from one exchange,
    and no less, whatever the network's delays are.
    """

    clock: ClockSync
    low_ns: int
    high_ns: int

    @property
    def width_ns(self) -> int:
        """How little is known."""
        return self.high_ns - self.low_ns


def reading(clock: ClockSync, asked_ns: int, came_ns: int) -> Reading:
    """From CLOCK_REALTIME here before and after an exchange."""
    return Reading(clock, clock.now_ns - came_ns, clock.now_ns - asked_ns)


def said_apart(clocks: Mapping[str, ClockSync]) -> int | None:
    """Stamps of these boards that are of one instant differ by no more than this, ns, by their own word.

    None where one of them is not synchronised, or cannot tell: then nothing is promised. What two boards may be off
    the reference adds up; this holds only where all follow the same one.
    """
    errors = sorted((c.error_ns for c in clocks.values() if c.synchronised and c.error_ns), reverse=True)
    if len(errors) != len(clocks):
        return None
    return sum(errors[:2]) if len(errors) > 1 else 0


def contradictions(readings: Mapping[str, Reading], own_error_ns: int) -> dict[str, str]:
    """Boards whose clock is measured to be further off than they say; `own_error_ns` is this machine's."""
    found = {}
    for name, each in readings.items():
        claimed = each.clock.error_ns + own_error_ns
        away = max(each.low_ns, -each.high_ns, 0)
        if each.clock.synchronised and own_error_ns and away > claimed:
            found[name] = f"it is off by {away / 1e6:.3f} ms at least, and says {claimed / 1e6:.3f} at most"
    return found
