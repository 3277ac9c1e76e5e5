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

from dataclasses import replace

from cm.design.errors import BuildError
from cm.design.partition.integer_program import Program, solve
from cm.design.partition.model import Partition, Problem, compatible, evaluate, group_of

SECONDS = 10.0


def advise(problem: Problem, objective: str = "worst", seconds: float = SECONDS) -> Partition:
    """Return the partition with the least ``worst`` or ``mean`` time; of equally fast ones, the smallest.

    After `seconds`, return the best one found so far; its `bound` says how good another could be. Raises
    BuildError if none fits the part, or none was found in that time.
    """
    if objective not in ("worst", "mean"):
        raise BuildError(f"{objective} is not an objective: worst or mean")
    if any(group_of(problem, [name]).share > 1 for name in problem.units):
        raise _nothing_fits(problem)
    answer = solve(Program(problem, objective), seconds)
    if answer.impossible:
        raise _nothing_fits(problem)
    simple = first_fit(problem)
    found = [_partition(problem, groups) for groups in (answer.groups, simple) if groups]
    fitting = [partition for partition in found if partition.fits]
    if not fitting:
        raise BuildError(f"no partition was found in {seconds:g} s, nor proof that there is none: give it more time")
    best = min(fitting, key=lambda partition: float(getattr(partition, objective)))
    time = float(getattr(best, objective))
    return replace(best, bound=time if answer.proved else min(answer.bound, time))


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
