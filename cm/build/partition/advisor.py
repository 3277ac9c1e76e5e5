# SPDX-License-Identifier: Apache-2.0
"""The partitioning advisor: which modules share a region, so that reconfiguration takes the least time.

A region must hold the largest of its modules in every resource, and loading it costs time in
proportion to its configuration data, which grows with its size whatever is loaded. Modules that are
active together cannot share a region, nor modules of different interfaces (that would make every
region as wide as all). Choosing groups of compatible modules so that the worst or the mean time of a
change of mode is smallest, under the part's resources, is a set partitioning problem; the model is
that of Vipin and Fahmy, "Automated Partitioning for Partial Reconfiguration Design of Adaptive
Systems" (IPDPSW 2013), solved exactly as a mixed-integer linear program by HiGHS
(Huangfu and Hall 2018) through `scipy.optimize.milp`.

A region's size is the largest fraction of the part that any resource of it takes, rounded up to
`GRAIN` of the device, as pblocks are; its data is that share of the device's frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from cm.build.errors import BuildError, MissingTool
from cm.build.project.model import Resources

MAX_GROUPS = 20_000
ROOM = 1.2  # what placement and routing need beyond the modules' resources
GRAIN = 1 / 64
NOTHING = Resources()


@dataclass(frozen=True, slots=True)
class Part:
    """A device: its resources, and the bytes of its full configuration."""

    name: str
    resources: Resources
    bytes: int


@dataclass(frozen=True, slots=True)
class Unit:
    """A module to be placed: `kind` must be equal within a region (the interfaces)."""

    name: str
    resources: Resources
    kind: str = ""


@dataclass(frozen=True, slots=True)
class UsedMode:
    """A mode: its modules, and how often it is entered."""

    name: str
    modules: frozenset[str]
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Group:
    """A region: its modules and what it needs. `share` of the device, `bytes` of one load."""

    modules: tuple[str, ...]
    resources: Resources
    share: float
    bytes: int


@dataclass(frozen=True, slots=True)
class Partition:
    """Regions with their figures; times in seconds for the changes of mode."""

    groups: tuple[Group, ...]
    worst: float
    worst_change: tuple[str, str]
    mean: float
    share: float  # of the device, of the scarcest resource
    fits: bool


@dataclass(frozen=True, slots=True)
class Problem:
    """What is given: `rate` in bytes per second of the configuration port, `static` what the static part needs.

    `budget` is the share of the part that the regions may take together, at most.
    """

    part: Part
    units: Mapping[str, Unit]
    modes: Sequence[UsedMode]
    rate: float
    static: Resources = NOTHING
    budget: float = 1.0

    @property
    def room(self) -> float:
        """The share of the part that is left for regions."""
        return min(self.budget, 1.0 - _static_share(self))


def group_of(problem: Problem, modules: Sequence[str]) -> Group:
    """The region that holds each of `modules`."""
    need = Resources()
    for name in modules:
        need = need.largest(problem.units[name].resources)
    shares = [
        ROOM * have / total if total else (float("inf") if have else 0.0)
        for have, total in zip(need.values(), problem.part.resources.values(), strict=True)
    ]
    grains = max(1, -(-max(shares) // GRAIN)) if max(shares) != float("inf") else float("inf")
    share = grains * GRAIN
    size = int(problem.part.bytes * share) if share != float("inf") else 0
    return Group(tuple(modules), need, share, size)


def evaluate(problem: Problem, groups: Sequence[Group]) -> Partition:
    """The figures of a partition: worst and mean time over all ordered changes of mode."""
    worst, change, total, weight = 0.0, ("", ""), 0.0, 0.0
    for before, after in itertools.permutations(problem.modes, 2):
        time = sum(_loads(group, before, after) * group.bytes for group in groups) / problem.rate
        if time > worst:
            worst, change = time, (before.name, after.name)
        total += before.share * after.share * time
        weight += before.share * after.share
    share = sum(group.share for group in groups) + _static_share(problem)
    mean = total / weight if weight else 0.0
    fits = sum(group.share for group in groups) <= problem.room + 1e-9
    return Partition(tuple(groups), worst, change, mean, share, fits)


def _loads(group: Group, before: UsedMode, after: UsedMode) -> bool:
    """Whether the change may load the region: `after` has one of its modules, which `before` has not.

    What `before` does not name is as an earlier mode left it, so a load is counted; but a region of one
    module is loaded once and for all.
    """
    wanted = [name for name in group.modules if name in after.modules]
    return len(group.modules) > 1 and bool(wanted) and not set(wanted) <= before.modules


def _static_share(problem: Problem) -> float:
    totals = problem.part.resources.values()
    return max(
        (have / total for have, total in zip(problem.static.values(), totals, strict=True) if total), default=0.0
    )


def compatible(problem: Problem, modules: Sequence[str]) -> bool:
    """Whether the modules may share a region: of one kind, and no two in one mode."""
    kinds = {problem.units[name].kind for name in modules}
    return len(kinds) == 1 and not any(len(mode.modules.intersection(modules)) > 1 for mode in problem.modes)


def candidates(problem: Problem) -> list[Group]:
    """Every group of compatible modules; BuildError where there are too many to list."""
    found: list[tuple[str, ...]] = []
    for name in problem.units:
        found += [(*group, name) for group in found if compatible(problem, (*group, name))]
        found.append((name,))
        if len(found) > MAX_GROUPS:
            raise BuildError(f"more than {MAX_GROUPS} possible regions: the advisor is exact, so for small cases only")
    return [group_of(problem, group) for group in found]


def advise(problem: Problem, objective: str = "worst") -> Partition:
    """The best partition by ``worst`` or ``mean`` time; BuildError where none fits the part.

    Of equally fast ones the smallest is taken.
    """
    if objective not in ("worst", "mean"):
        raise BuildError(f"{objective} is no objective: worst or mean")
    groups = [group for group in candidates(problem) if group.share <= 1]
    chosen = _solve(problem, groups, objective)
    order = {name: index for index, name in enumerate(problem.units)}
    return evaluate(problem, sorted(chosen, key=lambda group: order[group.modules[0]]))


def _solve(problem: Problem, groups: list[Group], objective: str) -> list[Group]:
    """Columns: one per group, then the worst time. Rows: each module once, the device, each change's time."""
    try:
        import numpy
        from scipy.optimize import Bounds, LinearConstraint, milp
    except ImportError:
        raise MissingTool("the advisor needs scipy: pip install 'fpga-cm[build]'") from None
    count = len(groups)
    changes = list(_weighted_changes(problem))
    times = numpy.array([[_loads(g, a, b) * g.bytes / problem.rate for g in groups] for a, b, _ in changes])
    times = times.reshape(len(changes), count)
    once = numpy.array([[float(name in group.modules) for group in groups] for name in problem.units])
    shares = numpy.array([group.share for group in groups])
    column = numpy.zeros((len(problem.units), 1))
    rows = [
        LinearConstraint(numpy.hstack([once.reshape(-1, count), column]), 1, 1),
        LinearConstraint(numpy.append(shares, 0.0), -numpy.inf, problem.room + 1e-9),
    ]
    if objective == "worst" and changes:
        rows.append(LinearConstraint(numpy.hstack([times, -numpy.ones((len(changes), 1))]), -numpy.inf, 0))
    scale = sum(group.bytes for group in groups) / problem.rate or 1.0
    if objective == "worst":
        cost = numpy.append(shares * scale * 1e-9, 1.0)
    else:
        weights = numpy.array([weight for _, _, weight in changes])
        total = weights.sum() or 1.0
        cost = numpy.append((weights @ times) / total + shares * scale * 1e-9, 0.0)
    kinds = numpy.append(numpy.ones(count), 0)
    upper = numpy.append(numpy.ones(count), numpy.inf)
    found = milp(cost / scale, integrality=kinds, bounds=Bounds(0, upper), constraints=rows)
    if found.x is None:
        raise BuildError(
            f"no partition fits {problem.part.name}: the modules need more than the {problem.room:.1%} that is left for"
            " regions"
        )
    return [group for group, value in zip(groups, found.x[:count], strict=True) if value > 0.5]


def _weighted_changes(problem: Problem) -> Iterator[tuple[UsedMode, UsedMode, float]]:
    for before, after in itertools.permutations(problem.modes, 2):
        yield before, after, before.share * after.share
