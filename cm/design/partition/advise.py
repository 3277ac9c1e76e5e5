# SPDX-License-Identifier: Apache-2.0
"""Converts a project to the advisor's problem, and its present regions to a partition."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from cm.design.boundary.analyse import Analysis
from cm.design.errors import BuildError
from cm.design.partition.external import bound
from cm.design.partition.model import Group, Problem, Unit, UsedMode, group_of
from cm.design.partition.parts import part_of
from cm.design.partition.utilisation import read_utilisation
from cm.design.platforms import device_of, platform_of
from cm.design.project.model import ModuleSpec, Project, Resources

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


def with_reports(project: Project, folders: Iterable[Path]) -> tuple[Project, dict[str, Path]]:
    """Return `project` with the resources in Vivado's reports, and the report that was read for each module.

    `resources:` in the build schema takes precedence. A module's report is that of the generated flow,
    ``synth_<module>.utilization.rpt``, or ``<module>.rpt``, in the first folder that has one.
    """
    listed = list(folders)
    modules, read = dict(project.modules), {}
    for name, spec in project.modules.items():
        names = (f"synth_{name}.utilization.rpt", f"{name}.utilization.rpt", f"{name}.rpt")
        path = next((folder / file for folder in listed for file in names if (folder / file).is_file()), None)
        if path is not None and not spec.resources:
            modules[name], read[name] = replace(spec, resources=read_utilisation(path)), path
    return replace(project, modules=modules), read


def static_report(folders: Iterable[Path]) -> Path | None:
    """The generated flow's report on the static part, in the first folder that has one."""
    paths = (folder / "static_synth.utilization.rpt" for folder in folders)
    return next((path for path in paths if path.is_file()), None)


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
