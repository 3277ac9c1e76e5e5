# SPDX-License-Identifier: Apache-2.0
"""What a measurement found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Goal:
    """What a ratio (or, without baseline, a value) should be: at least or at most `bound`."""

    bound: float
    at_least: bool = False

    def met(self, number: float) -> bool:
        """Whether a number keeps to it."""
        return number >= self.bound if self.at_least else number <= self.bound

    def __str__(self) -> str:
        return f"{'≥' if self.at_least else '≤'} {self.bound:g}"


@dataclass(frozen=True, slots=True)
class Result:
    """One figure.

    `ratio` is what the goal is about: how many times faster than the baseline if the goal is "at least", value
    divided by baseline if it is "at most". What could not be measured is None, and
    `missing` says why. `details` holds what else belongs to the figure, as JSON has it.
    """

    name: str
    value: float | None
    unit: str
    ran: str
    baseline: float | None = None
    ratio: float | None = None
    goal: Goal | None = None
    missing: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def met(self) -> bool | None:
        """Whether the goal was reached; None where there is none, or no number."""
        number = self.value if self.ratio is None and self.baseline is None and not self.missing else self.ratio
        return None if self.goal is None or number is None else self.goal.met(number)

    def plain(self) -> dict[str, Any]:
        """As it stands in the JSON file."""
        return {
            "value": self.value,
            "unit": self.unit,
            "baseline": self.baseline,
            "ratio": self.ratio,
            "goal": str(self.goal) if self.goal else None,
            "met": self.met,
            "missing": self.missing or None,
            "ran": self.ran,
            **self.details,
        }


def unavailable(name: str, unit: str, ran: str, why: str, goal: Goal | None = None) -> Result:
    """A figure that this machine cannot give."""
    return Result(name, None, unit, ran, goal=goal, missing=why)
