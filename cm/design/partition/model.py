# SPDX-License-Identifier: Apache-2.0
"""Modules, modes and a part; regions as groups of modules, and the costs of loading them.

A region's size is the largest fraction of the part that any resource of it takes, rounded up to
`GRAIN` of the device, as pblocks are; its data is that share of the device's frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cm.design.project.model import Resources

ROOM = 1.2  # how much placement and routing need beyond the modules' resources
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
    """Regions with their figures; times in seconds for the changes of mode.

    `bound`: a lower bound of the worst time (or mean time, if that was asked for) of any partition; None: not computed.
    """

    groups: tuple[Group, ...]
    worst: float
    worst_change: tuple[str, str]
    mean: float
    share: float  # of the device, by the scarcest resource
    fits: bool
    bound: float | None = None

    def gap(self, objective: str) -> float:
        """How far the time may be from the optimum, as a share of it; 0: proved optimal."""
        time: float = getattr(self, objective)
        if self.bound is None or not time:
            return 0.0
        return max(0.0, (time - self.bound) / time)


@dataclass(frozen=True, slots=True)
class Problem:
    """The input: `rate`: of the configuration port, in bytes per second; `static`: what the static part needs.

    `budget`: the largest share of the part that all regions together may take; `regions`: the most regions that
    there may be. The units in each set of `together` go to one region, because they share something outside it.
    """

    part: Part
    units: Mapping[str, Unit]
    modes: Sequence[UsedMode]
    rate: float
    static: Resources = NOTHING
    budget: float = 1.0
    regions: int | None = None
    together: Sequence[frozenset[str]] = ()

    @property
    def room(self) -> float:
        """The share of the part that is left for regions."""
        return min(self.budget, 1.0 - _static_share(self))


def group_of(problem: Problem, modules: Sequence[str]) -> Group:
    """Return the region that can hold each of `modules`."""
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
    """Compute the figures of a partition: worst and mean time over all ordered pairs of modes."""
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
    fits = fits and (problem.regions is None or len(groups) <= problem.regions)
    return Partition(tuple(groups), worst, change, mean, share, fits)


def _loads(group: Group, before: UsedMode, after: UsedMode) -> bool:
    """Whether the change may load the region: `after` has one of its modules that `before` does not have.

    A region that `before` does not name is as an earlier mode left it, so a load is counted; but a region
    with a single module is loaded only once.
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
