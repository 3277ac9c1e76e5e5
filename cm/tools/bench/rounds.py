# SPDX-License-Identifier: Apache-2.0
"""Timing in interleaved rounds, so that disturbances of the machine affect all contestants alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cm.tools.bench.result import Goal, Result, unavailable

Batch = Callable[[int], tuple[float, ...]]  # makes that many trips; returns their durations in µs


@dataclass(frozen=True, slots=True)
class Plan:
    """How often: `rounds` times, each contestant in turn makes `trips` trips, after `warm` unmeasured ones."""

    rounds: int
    trips: int
    warm: int


@dataclass(frozen=True, slots=True)
class Samples:
    """Durations in µs, by round."""

    rounds: tuple[tuple[float, ...], ...]

    @property
    def median(self) -> float:
        """Of all trips."""
        return statistics.median(self.all)

    @property
    def p99(self) -> float:
        """99 of 100 trips were not longer."""
        ordered = sorted(self.all)
        return ordered[min(len(ordered) - 1, len(ordered) * 99 // 100)]

    @property
    def best(self) -> float:
        """Median of the least disturbed round."""
        return min(map(statistics.median, self.rounds))

    @property
    def all(self) -> tuple[float, ...]:
        """Every trip."""
        return tuple(value for values in self.rounds for value in values)

    def over(self, other: Samples) -> float:
        """How many times as long as another contestant: the median of the rounds' ratios."""
        pairs = zip(self.rounds, other.rounds, strict=True)
        return statistics.median(statistics.median(mine) / statistics.median(theirs) for mine, theirs in pairs)

    def plain(self) -> dict[str, float | int]:
        """As it stands in the JSON file; µs."""
        return {"median": self.median, "p99": self.p99, "best": self.best, "trips": len(self.all)}


def timed(trip: Callable[[], object]) -> Batch:
    """A contestant made from a function that makes one trip."""

    def batch(count: int) -> tuple[float, ...]:
        clock = time.perf_counter_ns
        durations = []
        for _ in range(count):
            before = clock()
            trip()
            durations.append((clock() - before) / 1e3)
        return tuple(durations)

    return batch


def interleave(contestants: Mapping[str, Batch], plan: Plan) -> dict[str, Samples]:
    """Time all contestants, round by round."""
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in contestants}
    for _ in range(plan.rounds):
        for name, batch in contestants.items():
            batch(plan.warm)
            found[name].append(batch(plan.trips))
    return {name: Samples(tuple(rounds)) for name, rounds in found.items()}


def beside(
    name: str, ran: str, ours: Samples, theirs: Samples | None, goal: Goal | None = None, missing: str = ""
) -> Result:
    """Ours beside a baseline, as a result; without the baseline, which is `missing`, not available."""
    if theirs is None:
        return unavailable(name, "µs", ran, missing, goal)
    ratio = theirs.over(ours) if goal is not None and goal.at_least else ours.over(theirs)
    details = {"samples": {"ours": ours.plain(), "baseline": theirs.plain()}}
    return Result(name, ours.median, "µs", ran, theirs.median, ratio, goal, details=details)
