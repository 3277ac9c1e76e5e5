# SPDX-License-Identifier: Apache-2.0
"""The partitioning advisor: which modules share a region, so that reconfiguration takes the least time.

A region must hold the largest of its modules in every resource, and loading it costs time in
proportion to its configuration data, which grows with its size whatever is loaded. Modules that are
active together cannot share a region, nor can modules with different interfaces (every region would
then need the interfaces of all). Choosing groups of compatible modules so that the worst or the mean time of a
change of mode is smallest, under the part's resources, is the problem of Vipin and Fahmy, "Automated
Partitioning for Partial Reconfiguration Design of Adaptive Systems" (IPDPSW 2013).

They choose among all possible groups, which are too many from about twenty modules on. Two properties
allow a program whose size is quadratic in the number of modules. A group is only as large as its largest
module, which is called its representative. And at most one module of a group is active in a mode, so
what a change loads is a sum over modules. This makes it graph colouring by asymmetric representatives
(Campêlo, Campos and Corrêa, "On the asymmetric representatives formulation for the vertex coloring
problem", 2008), solved as a mixed-integer linear program by HiGHS (Huangfu and Hall 2018) through
`scipy.optimize.milp`, which also says how much better another partition could be when time runs out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from cm.design.errors import BuildError, MissingTool
from cm.design.partition.model import GRAIN, Partition, Problem, UsedMode, compatible, evaluate, group_of
from cm.extras import installing

SECONDS = 10.0
_INFINITE = float("inf")
_SCALE = 1000.0  # HiGHS stops at an absolute gap of 1e-6, which must be small compared with a grain
_SMALLER = {"worst": 1e-3, "mean": 1e-5}  # the weight of a grain of size relative to one of time

_Row = dict[int, float]


def advise(problem: Problem, objective: str = "worst", seconds: float = SECONDS) -> Partition:
    """Return the partition with the least ``worst`` or ``mean`` time; of equally fast ones, the smallest.

    After `seconds`, return the best one found so far; its `bound` says how good another could be. Raises
    BuildError if none fits the part, or none was found in that time.
    """
    if objective not in ("worst", "mean"):
        raise BuildError(f"{objective} is not an objective: worst or mean")
    if any(group_of(problem, [name]).share > 1 for name in problem.units):
        raise _nothing_fits(problem)
    program = _Program(problem, objective)
    answer = program.solve(seconds)
    if answer.status == 2:  # impossible
        raise _nothing_fits(problem)
    solved = program.groups(answer.x) if answer.x is not None else []
    found = [_partition(problem, groups) for groups in (solved, first_fit(problem)) if groups]
    fitting = [partition for partition in found if partition.fits]
    if not fitting:
        raise BuildError(f"no partition was found in {seconds:g} s, nor proof that there is none: give it more time")
    best = min(fitting, key=lambda partition: float(getattr(partition, objective)))
    time = float(getattr(best, objective))
    proved = answer.status == 0  # no other is better
    return replace(best, bound=time if proved else min(program.bound(answer.mip_dual_bound or 0.0), time))


def first_fit(problem: Problem) -> list[list[str]]:
    """A simple partition: each module, largest first, goes to the first region that takes it; it may not fit."""
    groups: list[list[str]] = []
    bound = {name: sorted(names) for names in problem.together for name in names}
    placed: set[str] = set()
    for name in sorted(problem.units, key=lambda name: -group_of(problem, [name]).share):
        if name in placed:
            continue
        atom = bound.get(name, [name])
        placed.update(atom)
        home = next((group for group in groups if compatible(problem, [*group, *atom])), None)
        if home is None:
            groups.append(list(atom))
        else:
            home += atom
    return groups


def _partition(problem: Problem, groups: list[list[str]]) -> Partition:
    order = {name: index for index, name in enumerate(problem.units)}
    sorted_groups = sorted((sorted(group, key=order.__getitem__) for group in groups), key=lambda g: order[g[0]])
    return evaluate(problem, [group_of(problem, group) for group in sorted_groups])


def _nothing_fits(problem: Problem) -> BuildError:
    limit = f" and {problem.regions} regions" if problem.regions is not None else ""
    return BuildError(
        f"no partition fits {problem.part.name}: the modules need more than the {problem.room:.1%}{limit} that"
        " is left for regions"
    )


class _Program:
    """Columns and rows of a problem; `objective` is ``worst`` or ``mean``.

    Columns, for units m and l where m is not larger than l and may share its region: `in[m, l]`: m goes to
    the region whose largest unit is l (`in[l, l]`: there is such a region); `shared[l]`: that region has a second
    unit, so that changes of mode load it; and the worst time. Times are counted in `GRAIN`s of the device.
    """

    def __init__(self, problem: Problem, objective: str) -> None:
        self._problem = problem
        self._objective = objective
        self._grains = {name: group_of(problem, [name]).share / GRAIN for name in problem.units}
        order = sorted(problem.units, key=lambda name: -self._grains[name])
        self._places = {
            pair: column
            for column, pair in enumerate(
                (small, large)
                for index, large in enumerate(order)
                for small in order[index:]
                if small == large or compatible(problem, (small, large))
            )
        }
        self._shared = {name: len(self._places) + index for index, name in enumerate(order)}
        self._worst = len(self._places) + len(order)
        self._rows: list[tuple[_Row, float, float]] = []
        self._cover()
        self._regions()
        for names in problem.together:
            self._tie(sorted(names))
        if objective == "worst":
            for loaded in _largest(after.modules - before.modules for before, after in self._changes()):
                self._rows.append(({**self._time(loaded), self._worst: -1.0}, -_INFINITE, 0.0))

    def _cost(self) -> _Row:
        """The objective: time, plus a small weight for size."""
        cost: _Row = {self._worst: _SCALE} if self._objective == "worst" else {}
        total = sum(before.share * after.share for before, after in self._changes()) or 1.0
        if self._objective == "mean":
            for before, after in self._changes():
                for column, grains in self._time(after.modules - before.modules).items():
                    cost[column] = cost.get(column, 0.0) + _SCALE * grains * before.share * after.share / total
        for name, grains in self._grains.items():
            column = self._places[name, name]
            cost[column] = cost.get(column, 0.0) + _SCALE * _SMALLER[self._objective] * GRAIN * grains
        return cost

    def bound(self, cost: float) -> float:
        """Convert a bound of the cost to seconds that no partition can beat, even with regions as large as the part."""
        grains = max(0.0, cost / _SCALE - _SMALLER[self._objective])
        seconds = self._problem.part.bytes * GRAIN / self._problem.rate  # to load one grain
        return (math.ceil(grains - 1e-6) if self._objective == "worst" else grains) * seconds

    def _cover(self) -> None:
        for name in self._problem.units:
            row = {column: 1.0 for (unit, _), column in self._places.items() if unit == name}
            self._rows.append((row, 1.0, 1.0))

    def _regions(self) -> None:
        """Rows of regions: units only in those that exist, one unit per mode; limits on their number and size."""
        for (unit, home), column in self._places.items():
            if unit != home:
                self._rows.append(({column: 1.0, self._shared[home]: -1.0}, -_INFINITE, 0.0))
                self._rows.append(({column: 1.0, self._places[home, home]: -1.0}, -_INFINITE, 0.0))
        for home in self._problem.units:
            for modules in {mode.modules for mode in self._problem.modes}:
                row = {self._places[m, home]: 1.0 for m in modules if m != home and (m, home) in self._places}
                if len(row) > 1:
                    self._rows.append(({**row, self._places[home, home]: -1.0}, -_INFINITE, 0.0))
        sizes = {self._places[name, name]: grains for name, grains in self._grains.items()}
        self._rows.append((sizes, -_INFINITE, self._problem.room / GRAIN + 1e-6))
        if self._problem.regions is not None:
            self._rows.append((dict.fromkeys(sizes, 1.0), -_INFINITE, float(self._problem.regions)))

    def _tie(self, names: list[str]) -> None:
        """Put all of `names` into one region, whichever unit is its largest."""
        for first, second in itertools.pairwise(names):
            for home in self._problem.units:
                signs = {first: 1.0, second: -1.0}
                row = {self._places[n, home]: sign for n, sign in signs.items() if (n, home) in self._places}
                if row:
                    self._rows.append((row, 0.0, 0.0))

    def _time(self, loaded: Iterable[str]) -> _Row:
        """Grains that are loaded for `loaded`; none for a unit that is alone in its region."""
        wanted = set(loaded)
        row: _Row = {}
        for (unit, home), column in self._places.items():
            if unit in wanted:
                where = self._shared[home] if unit == home else column
                row[where] = row.get(where, 0.0) + self._grains[home]
        return row

    def _changes(self) -> Iterator[tuple[UsedMode, UsedMode]]:
        return itertools.permutations(self._problem.modes, 2)

    def solve(self, seconds: float) -> Any:
        """Run HiGHS: a solution of scipy, whose bound is of the cost. Raises MissingTool if scipy is not installed."""
        try:
            import numpy
            from scipy.optimize import Bounds, LinearConstraint, milp
            from scipy.sparse import coo_array
        except ImportError:
            raise MissingTool(f"the advisor needs scipy: {installing('build')}") from None
        width = self._worst + 1
        cells = [
            (index, column, value) for index, (row, _, _) in enumerate(self._rows) for column, value in row.items()
        ]
        lines, columns, values = (numpy.array(part) for part in zip(*cells, strict=True))
        matrix = coo_array((values, (lines, columns)), shape=(len(self._rows), width)).tocsr()
        low, high = (numpy.array([row[which] for row in self._rows]) for which in (1, 2))
        cost, whole, upper = numpy.zeros(width), numpy.ones(width), numpy.ones(width)
        for column, value in self._cost().items():
            cost[column] = value
        whole[self._worst], upper[self._worst] = 0, _INFINITE
        options = {"time_limit": seconds, "mip_rel_gap": 0.0}
        rows = LinearConstraint(matrix, low, high)
        return milp(cost, integrality=whole, bounds=Bounds(0, upper), constraints=rows, options=options)

    def groups(self, values: Sequence[float]) -> list[list[str]]:
        """The regions of a solution."""
        found: dict[str, list[str]] = {}
        for (unit, home), column in self._places.items():
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
