# SPDX-License-Identifier: Apache-2.0
"""The advisor's problem as a mixed-integer linear program.

Columns, for units m and l where m is not larger than l and may share its region: `in[m, l]`: m goes to
the region whose largest unit is l (`in[l, l]`: there is such a region); `shared[l]`: that region has a second
unit, so that changes of mode load it; and the worst time. Times are counted in `GRAIN`s of the device.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from cm.design.errors import MissingTool
from cm.design.partition.model import GRAIN, Problem, UsedMode, compatible, group_of

INFINITE = float("inf")
SCALE = 1000.0  # HiGHS stops at an absolute gap of 1e-6, which must be small compared with a grain
SMALLER = {"worst": 1e-3, "mean": 1e-5}  # the weight of a grain of size relative to one of time

Row = dict[int, float]


@dataclass(frozen=True, slots=True)
class Answer:
    """The solver's answer: no groups if it found none in time; `bound` in seconds, as far as it was proved."""

    groups: list[list[str]]
    bound: float
    proved: bool = False  # no other is better
    impossible: bool = False


class Program:
    """Columns and rows of a problem; `objective` is ``worst`` or ``mean``."""

    def __init__(self, problem: Problem, objective: str) -> None:
        self._problem = problem
        self.objective = objective
        self.grains = {name: group_of(problem, [name]).share / GRAIN for name in problem.units}
        order = sorted(problem.units, key=lambda name: -self.grains[name])
        self.places = {
            pair: column
            for column, pair in enumerate(
                (small, large)
                for index, large in enumerate(order)
                for small in order[index:]
                if small == large or compatible(problem, (small, large))
            )
        }
        self._shared = {name: len(self.places) + index for index, name in enumerate(order)}
        self.worst = len(self.places) + len(order)
        self.rows: list[tuple[Row, float, float]] = []
        self._cover()
        self._regions()
        for names in problem.together:
            self._tie(sorted(names))
        if objective == "worst":
            for loaded in _largest(after.modules - before.modules for before, after in self._changes()):
                self.rows.append(({**self._time(loaded), self.worst: -1.0}, -INFINITE, 0.0))

    @property
    def width(self) -> int:
        """How many columns."""
        return self.worst + 1

    @property
    def seconds(self) -> float:
        """The time to load one grain."""
        return self._problem.part.bytes * GRAIN / self._problem.rate

    def cost(self) -> Row:
        """The objective: time, plus a small weight for size."""
        cost: Row = {self.worst: SCALE} if self.objective == "worst" else {}
        total = sum(before.share * after.share for before, after in self._changes()) or 1.0
        if self.objective == "mean":
            for before, after in self._changes():
                for column, grains in self._time(after.modules - before.modules).items():
                    cost[column] = cost.get(column, 0.0) + SCALE * grains * before.share * after.share / total
        for name, grains in self.grains.items():
            column = self.places[name, name]
            cost[column] = cost.get(column, 0.0) + SCALE * SMALLER[self.objective] * GRAIN * grains
        return cost

    def bound(self, cost: float) -> float:
        """Convert a bound of the cost to seconds that no partition can beat, even with regions as large as the part."""
        grains = max(0.0, cost / SCALE - SMALLER[self.objective])
        return (math.ceil(grains - 1e-6) if self.objective == "worst" else grains) * self.seconds

    def _cover(self) -> None:
        for name in self._problem.units:
            row = {column: 1.0 for (unit, _), column in self.places.items() if unit == name}
            self.rows.append((row, 1.0, 1.0))

    def _regions(self) -> None:
        """Rows of regions: units only in those that exist, one unit per mode; limits on their number and size."""
        for (unit, home), column in self.places.items():
            if unit != home:
                self.rows.append(({column: 1.0, self._shared[home]: -1.0}, -INFINITE, 0.0))
                self.rows.append(({column: 1.0, self.places[home, home]: -1.0}, -INFINITE, 0.0))
        for home in self._problem.units:
            for modules in {mode.modules for mode in self._problem.modes}:
                row = {self.places[m, home]: 1.0 for m in modules if m != home and (m, home) in self.places}
                if len(row) > 1:
                    self.rows.append(({**row, self.places[home, home]: -1.0}, -INFINITE, 0.0))
        sizes = {self.places[name, name]: grains for name, grains in self.grains.items()}
        self.rows.append((sizes, -INFINITE, self._problem.room / GRAIN + 1e-6))
        if self._problem.regions is not None:
            self.rows.append((dict.fromkeys(sizes, 1.0), -INFINITE, float(self._problem.regions)))

    def _tie(self, names: list[str]) -> None:
        """Put all of `names` into one region, whichever unit is its largest."""
        for first, second in itertools.pairwise(names):
            for home in self._problem.units:
                row = {self.places[first, home]: 1.0} if (first, home) in self.places else {}
                if (second, home) in self.places:
                    row[self.places[second, home]] = -1.0
                if row:
                    self.rows.append((row, 0.0, 0.0))

    def _time(self, loaded: Iterable[str]) -> Row:
        """Grains that are loaded for `loaded`; none for a unit that is alone in its region."""
        wanted = set(loaded)
        row: Row = {}
        for (unit, home), column in self.places.items():
            if unit in wanted:
                where = self._shared[home] if unit == home else column
                row[where] = row.get(where, 0.0) + self.grains[home]
        return row

    def _changes(self) -> Iterator[tuple[UsedMode, UsedMode]]:
        return itertools.permutations(self._problem.modes, 2)

    def groups(self, values: Mapping[int, float]) -> list[list[str]]:
        """The regions of a solution."""
        found: dict[str, list[str]] = {}
        for (unit, home), column in self.places.items():
            if values[column] > 0.5:
                found.setdefault(home, []).append(unit)
        return list(found.values())


def _largest(sets: Iterable[frozenset[str]]) -> list[frozenset[str]]:
    """The sets that no other one contains: loading more takes longer."""
    listed = sorted(set(sets), key=lambda names: (-len(names), sorted(names)))
    kept: list[frozenset[str]] = []
    for names in listed:
        if names and not any(names <= other for other in kept):
            kept.append(names)
    return kept


def solve(program: Program, seconds: float) -> Answer:
    """Run HiGHS. Raises MissingTool if scipy is not installed."""
    try:
        import numpy
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import coo_array
    except ImportError:
        raise MissingTool("the advisor needs scipy: pip install 'fpga-cm[advise]'") from None
    cells = [(index, column, value) for index, (row, _, _) in enumerate(program.rows) for column, value in row.items()]
    lines, columns, values = (numpy.array(part) for part in zip(*cells, strict=True))
    matrix = coo_array((values, (lines, columns)), shape=(len(program.rows), program.width)).tocsr()
    low, high = (numpy.array([row[which] for row in program.rows]) for which in (1, 2))
    cost, whole, upper = numpy.zeros(program.width), numpy.ones(program.width), numpy.ones(program.width)
    for column, value in program.cost().items():
        cost[column] = value
    whole[program.worst], upper[program.worst] = 0, INFINITE
    found = milp(
        cost,
        integrality=whole,
        bounds=Bounds(0, upper),
        constraints=LinearConstraint(matrix, low, high),
        options={"time_limit": seconds, "mip_rel_gap": 0.0},
    )
    groups = program.groups(dict(enumerate(found.x))) if found.x is not None else []
    least = found.mip_dual_bound if found.mip_dual_bound is not None else 0.0
    return Answer(groups, program.bound(least), proved=found.status == 0, impossible=found.status == 2)
