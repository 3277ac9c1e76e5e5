# SPDX-License-Identifier: Apache-2.0
"""All rules over a planned system."""

from __future__ import annotations

from cm.design.check.block_design import check_block_design
from cm.design.check.clocks import check_clocks
from cm.design.check.finding import Finding
from cm.design.check.floorplan import check_floorplan
from cm.design.check.pins import check_pins
from cm.design.errors import BuildError
from cm.design.plan import block_design
from cm.design.plan.system import System


def check_system(system: System) -> list[Finding]:
    """Return what Vivado would refuse and what a designer should know, in the order of the flow."""
    design = check_block_design(system, block_design.context(system))
    return [*check_clocks(system), *design, *check_floorplan(system), *check_pins(system)]


def refuse_errors(system: System) -> None:
    """Raise BuildError with everything that Vivado would refuse."""
    errors = [finding.text(system.project.source) for finding in check_system(system) if finding.error]
    if errors:
        raise BuildError("Vivado would refuse this design:\n  " + "\n  ".join(errors))
