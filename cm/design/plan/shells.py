# SPDX-License-Identifier: Apache-2.0
"""Abstract shells: a region with only the surroundings that a module needs, instead of the whole static design.

UG909, "Abstract Shell Design Flow": the first run is unchanged; a shell of each region is made from it, and every
other module is placed and routed in its region's shell. ``pr_verify`` compares the shell with the shell that holds the
module; comparing it with a full design fails ("Verifying Configurations").
"""

from __future__ import annotations

from cm.design.plan.cover import Cover
from cm.design.platforms import Platform
from cm.design.project.model import Project
from cm.design.project.where import fault

OLDEST = "2020.2"  # the first version of UG835 that has write_abstract_shell


def check_shells(project: Project, platform: Platform) -> None:
    """Raise a fault if Vivado has no abstract shells for this part or in this version."""
    if not project.static.abstract_shells:
        return
    key = ("static", "abstract_shells")
    if not platform.ultrascale:
        message = f"there are no abstract shells for {project.part}: 7 series are not supported (UG909)"
        raise fault(project.source, key, message, "leave it out: every run opens the static design then")
    if project.vivado is not None and project.vivado < OLDEST:
        message = f"Vivado {project.vivado} has no abstract shells"
        raise fault(project.source, key, message, f"{OLDEST} or newer has them")


def first_run(project: Project) -> Cover:
    """The only run of the whole design: the default mode's modules, and one module in every other region."""
    first = project.modes[project.default_mode].modules
    run = {}
    for region in project.regions:
        modules = [module.name for module in project.modules_of(region)]
        if modules:
            run[region] = first.get(region, modules[0])
    return Cover((run,), 1, exact=True)
