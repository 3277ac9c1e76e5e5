# SPDX-License-Identifier: Apache-2.0
"""What rates a PL clock can have, and whether one is near enough to what a schema wants.

The manager asks before it sets a clock, the build tool before it builds a design for it, and the simulated board runs
at what comes out.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

from cm.schema.model import Clock

# IOPLL with the crystal of most boards: 33.33 MHz times 30 (UG585), 33.33 MHz times 45 (UG1085); Hz by family
PLL: Mapping[str, int] = MappingProxyType({"7series": 999_999_990, "ultrascale+": 1_499_999_985})
_DIVIDERS = range(1, 64)  # two of six bits, one behind the other


def rounded(pll: int, hertz: int) -> int:
    """The highest rate of the two dividers that is not above `hertz`, else their lowest."""
    rates = _rates(pll)
    return max((rate for rate in rates if rate <= hertz), default=min(rates))


def nearest(pll: int, hertz: int) -> int:
    """The rate of the two dividers that is nearest to `hertz`, on either side."""
    return min(_rates(pll), key=lambda rate: (abs(rate - hertz), rate))


@lru_cache(maxsize=4)
def _rates(pll: int) -> frozenset[int]:
    return frozenset(pll // (first * second) for first in _DIVIDERS for second in _DIVIDERS)


def allowed(clock: Clock) -> float:
    """Hz by which the clock may be off; 1 Hz at least, because rates are whole numbers."""
    return max(1.0, clock.rate * clock.tolerance / 100)


def rate_problem(clock: Clock, rate: int) -> str:
    """Say why a rate is further from what is wanted than the schema allows; empty if it is not."""
    off = abs(rate - clock.rate)
    if off <= allowed(clock):
        return ""
    return (
        f"clock {clock.name} would run at {hertz(rate)} and {hertz(clock.rate)} is wanted, which is off by "
        f"{100 * off / clock.rate:.2g} %; {clock.tolerance:g} % is allowed (`tolerance`)"
    )


def hertz(rate: int | None) -> str:
    """A rate for people, to the Hz."""
    if rate is None:
        return "an unknown rate"
    return f"{rate / 1e6:.6f}".rstrip("0").rstrip(".") + " MHz"
