# SPDX-License-Identifier: Apache-2.0
"""Converts a project to the advisor's problem, and its present regions to a partition.

Modules that share something outside their region, such as pins of the board.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.boundary.analyse import Analysis
from cm.design.boundary.model import Boundary, Role
from cm.design.errors import BuildError
from cm.design.partition.model import Group, Problem, Unit, UsedMode, group_of
from cm.design.partition.utilisation import part_of
from cm.design.parts import device_of
from cm.design.platforms import platform_of
from cm.design.project.model import ModuleSpec, Project, RegionSpec, Resources

Place = tuple[str, str]  # module, region


def by_port(module: str, found: Boundary) -> dict[str, str]:
    """Port of the module → interface of the boundary, or the boundary's single port."""
    names = {port.name: port.interface or port.name for port in found.ports}
    return {c.module: names[c.boundary] for c in found.adaptation(module).connections if c.boundary and c.module}


def bound(project: Project, analysis: Analysis) -> list[frozenset[Place]]:
    """Sets of modules, with their region, that use the same ports of the top; the sets are disjoint."""
    sets: list[frozenset[Place]] = []
    for name, found in analysis.boundaries.items():
        uses = {module.name: set(by_port(module.name, found).values()) for module in project.modules_of(name)}
        for outside in _external(project.regions[name], found):
            users = frozenset((module, name) for module, used in uses.items() if outside in used)
            touching = [other for other in sets if other & users]
            sets = [other for other in sets if other not in touching] + [users.union(*touching)]
    return [members for members in sets if len(members) > 1]


def _external(region: RegionSpec, found: Boundary) -> Iterator[str]:
    """Interfaces and single ports of the boundary that go to ports of the top."""
    for interface in found.interfaces:
        given = region.interfaces.get(interface.name)
        connect = given.connect if given else None
        plain = interface.protocol in ("axis", "axi4", "axi4lite", "axi3")
        if connect in ("external", "switch") or (connect is None and not plain):
            yield interface.name
    for port in found.ports:
        given = region.interfaces.get(port.name)
        if (given and given.connect == "external") or (
            port.role is Role.CLOCK and region.clocks.get(port.name) == "external"
        ):
            yield port.name


ICAP_BYTES = 4  # per clock


def problem_of(
    project: Project,
    analysis: Analysis,
    rate: float | None = None,
    static: Resources | None = None,
    budget: float = 1.0,
    regions: int | None = None,
) -> Problem:
    """Make the problem of a project; `rate`: of the configuration port, in bytes per second (None: the ICAP's limit).

    `static`: what the static part needs; `budget`: the share of the part that regions may take; `regions`: the most
    regions that there may be.

    A module that fits several regions counts as one unit for each region that a mode puts it into.
    """
    missing = [module.name for module in project.modules.values() if not module.resources]
    if missing:
        hint = "synthesise them (cm build run), give reports with --reports, or estimate"
        raise BuildError(f"resources: is missing for {', '.join(missing)} ({hint})")
    tied = bound(project, analysis)
    kinds: dict[tuple[str, str], str] = {}
    for places in tied:  # they share a region already, even if they have other interfaces
        kind = ", or ".join(sorted({_kind(project, analysis, *place) for place in places}))
        kinds |= dict.fromkeys(places, kind)
    units = {}
    for module in project.modules.values():
        for region in module.regions:
            name = unit_name(module, region)
            kind = kinds.get((module.name, region)) or _kind(project, analysis, module.name, region)
            units[name] = Unit(name, module.resources, kind)
    modes = [
        UsedMode(mode.name, frozenset(unit_name(project.modules[m], r) for r, m in mode.modules.items()), mode.share)
        for mode in project.modes.values()
    ]
    limit = float(platform_of(project.part).icap_rate_max * ICAP_BYTES)
    part = part_of(device_of(project.part))
    together = [frozenset(unit_name(project.modules[m], r) for m, r in places) for places in tied]
    return Problem(part, units, modes, rate or limit, static or Resources(), budget, regions, together)


def todays_groups(project: Project, problem: Problem) -> list[Group]:
    """The regions of the build schema."""
    regions = [[unit_name(module, region) for module in project.modules_of(region)] for region in project.regions]
    return [group_of(problem, names) for names in regions if names]


def unit_name(module: ModuleSpec, region: str) -> str:
    """The module's name, with the region's if it may go to several."""
    return module.name if len(module.regions) == 1 else f"{module.name}_{region}"


def _kind(project: Project, analysis: Analysis, module: str, region: str) -> str:
    """Streams and memory ports of a module, and its region's clocks: modules may share a region only if these agree."""
    found = sorted(
        f"{i.protocol} {i.mode.value} {i.data_width}"
        for i in analysis.modules[module].interfaces
        if i.protocol != "axi4lite"
    )
    spec = project.regions[region]
    if any(connection.connect == "switch" for connection in spec.interfaces.values()):
        found.append(f"on the switch as {region}")  # routes of modes name the region
    clocks = [spec.clock, *(f"{port}={clock}" for port, clock in sorted(spec.clocks.items()))]
    return ", ".join([*found, *clocks, "" if spec.decoupling else "no decoupling"])
