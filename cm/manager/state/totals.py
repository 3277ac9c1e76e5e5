# SPDX-License-Identifier: Apache-2.0
"""Counters of changes and loads since the manager's start. Any thread may add and read."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

CHANGE_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)


class Distribution(NamedTuple):
    """How many values lie within each bound (the last entry has none), and the sum of all."""

    bounds: tuple[float, ...]
    at_most: tuple[int, ...]
    sum: float


class Histogram:
    """Values by size; the caller takes care of locking."""

    def __init__(self, bounds: Sequence[float]) -> None:
        self._bounds = tuple(bounds)
        self._counts = [0] * (len(self._bounds) + 1)
        self._sum = 0.0

    def add(self, value: float) -> None:
        """One more."""
        self._counts[bisect_left(self._bounds, value)] += 1
        self._sum += value

    def read(self) -> Distribution:
        """As it is now."""
        return Distribution(self._bounds, tuple(accumulate(self._counts)), self._sum)


class Times(NamedTuple):
    """How many there were, and the seconds that they took together."""

    number: int = 0
    seconds: float = 0.0


class Loads(NamedTuple):
    """Images that a port took: how many, their bytes, and its seconds."""

    number: int = 0
    bytes: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class ChangeCounts:
    """Changes by how they ended, with their times, those of each kind of step, and what was loaded."""

    outcomes: Mapping[str, int]
    failures: Mapping[str, int]  # by the error's code
    seconds: Distribution
    steps: Mapping[str, Times]
    loads: Mapping[str, Loads]


class ChangeTotals:
    """Adds up what changes do."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._outcomes = Counter[str]()
        self._failures = Counter[str]()
        self._seconds = Histogram(CHANGE_SECONDS)
        self._steps: dict[str, Times] = {}
        self._loads: dict[str, Loads] = {}

    def ended(self, code: str | None, seconds: float) -> None:
        """A change has ended; `code` is its error's, None where it went well."""
        with self._lock:
            self._outcomes["done" if code is None else "cancelled" if code == "cancelled" else "failed"] += 1
            if code is not None:
                self._failures[code] += 1
            self._seconds.add(seconds)

    def took(self, step: str, seconds: float) -> None:
        """A step went well."""
        with self._lock:
            so_far = self._steps.get(step, Times())
            self._steps[step] = Times(so_far.number + 1, so_far.seconds + seconds)

    def loaded(self, port: str, length: int, seconds: float) -> None:
        """An image of `length` bytes went through a port."""
        with self._lock:
            so_far = self._loads.get(port, Loads())
            self._loads[port] = Loads(so_far.number + 1, so_far.bytes + length, so_far.seconds + seconds)

    def read(self) -> ChangeCounts:
        """All counts, as of one moment."""
        with self._lock:
            return ChangeCounts(
                dict(self._outcomes), dict(self._failures), self._seconds.read(), dict(self._steps), dict(self._loads)
            )
