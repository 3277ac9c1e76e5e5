# SPDX-License-Identifier: Apache-2.0
"""How closely the clocks of several boards agree: by their own account, and as measured from here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cm.wire.messages.fleet import ClockSync


@dataclass(frozen=True, slots=True)
class Reading:
    """What a board says about its clock, and the clock's offset from this machine's: between `low_ns` and `high_ns`.

    The board read its clock after the request was sent and before the answer came: whatever the network's delays, one
    exchange shows that, and no more.
    """

    clock: ClockSync
    low_ns: int
    high_ns: int

    @property
    def width_ns(self) -> int:
        """How little is known."""
        return self.high_ns - self.low_ns


def reading(clock: ClockSync, asked_ns: int, came_ns: int) -> Reading:
    """A reading from CLOCK_REALTIME here before and after an exchange."""
    return Reading(clock, clock.now_ns - came_ns, clock.now_ns - asked_ns)


def said_apart(clocks: Mapping[str, ClockSync]) -> int | None:
    """How far timestamps of one instant may differ between these boards, ns, as they say themselves.

    None if one of them is not synchronised, or cannot tell. The errors of two boards add up; this holds only if all
    follow the same reference.
    """
    errors = sorted((c.error_ns for c in clocks.values() if c.synchronised and c.error_ns), reverse=True)
    if len(errors) != len(clocks):
        return None
    return sum(errors[:2]) if len(errors) > 1 else 0


def contradictions(readings: Mapping[str, Reading], own_error_ns: int) -> dict[str, str]:
    """Boards whose clocks are measurably further off than they say; `own_error_ns` is this machine's error."""
    found = {}
    for name, each in readings.items():
        claimed = each.clock.error_ns + own_error_ns
        away = max(each.low_ns, -each.high_ns, 0)
        if each.clock.synchronised and own_error_ns and away > claimed:
            found[name] = f"it is off by {away / 1e6:.3f} ms at least, and says {claimed / 1e6:.3f} at most"
    return found
