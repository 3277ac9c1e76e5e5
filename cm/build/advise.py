# SPDX-License-Identifier: Apache-2.0
"""A project as the advisor's problem, and its present regions as a partition."""

from __future__ import annotations

from cm.build.analyse import Analysis
from cm.build.errors import BuildError
from cm.build.partition import Group, Problem, Unit, UsedMode, group_of
from cm.build.parts import part_of
from cm.build.platforms import device_of, platform_of
from cm.build.project import ModuleSpec, Project

ICAP_BYTES = 4  # per clock


def problem_of(project: Project, analysis: Analysis, rate: float | None = None) -> Problem:
    """Modules, modes and part; `rate` in bytes per second (None: the limit of the ICAP).

    A module that fits several regions counts as one unit for each region that a mode puts it into.
    """
    missing = [module.name for module in project.modules.values() if not module.resources]
    if missing:
        hint = "take them from reports/synth_*.utilization.rpt, or estimate"
        raise BuildError(f"resources: is missing for {', '.join(missing)} ({hint})")
    units = {}
    for module in project.modules.values():
        for region in module.regions:
            name = unit_name(module, region)
            units[name] = Unit(name, module.resources, _kind(analysis, module.name))
    modes = [
        UsedMode(mode.name, frozenset(unit_name(project.modules[m], r) for r, m in mode.modules.items()), mode.share)
        for mode in project.modes.values()
    ]
    limit = float(platform_of(project.part).icap_rate_max * ICAP_BYTES)
    return Problem(part_of(device_of(project.part)), units, modes, rate or limit)


def todays_groups(project: Project, problem: Problem) -> list[Group]:
    """The regions of the build schema."""
    regions = [[unit_name(module, region) for module in project.modules_of(region)] for region in project.regions]
    return [group_of(problem, names) for names in regions if names]


def unit_name(module: ModuleSpec, region: str) -> str:
    """The module, with the region where it may go to several."""
    return module.name if len(module.regions) == 1 else f"{module.name}_{region}"


def _kind(analysis: Analysis, module: str) -> str:
    """Streams and memory ports of a module: only modules with the same ones share a region in a proposal."""
    found = sorted(
        f"{i.protocol} {i.mode.value} {i.data_width}"
        for i in analysis.modules[module].interfaces
        if i.protocol != "axi4lite"
    )
    return ", ".join(found)
