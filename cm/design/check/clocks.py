# SPDX-License-Identifier: Apache-2.0
"""Clocks of a region's modules: the build schema must name a source for each; none is connected by guess."""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.check.finding import Finding
from cm.design.plan.system import RegionPlan, System


def check_clocks(system: System) -> Iterator[Finding]:
    """Yield a finding for each clock whose source is not named, and for buses on a clock other than the region's."""
    for region in system.regions:
        key = ("regions", region.name, "clocks")
        for port in sorted(region.spec.clocks.keys() - region.clocks.keys()):
            hint = f"clocks are {', '.join(region.clocks) or 'none'}"
            yield Finding("clocks", (*key, port), f"no module of {region.name} has a clock {port}", hint)
        for port, clock in region.clocks.items():
            if clock is None:
                message = f"the modules of {region.name} have a clock {port} beside the region's: what drives it?"
                hint = f"write clocks: {{{port}: CLOCK}} with one of {', '.join(system.project.clocks)}, or external"
                yield Finding("clocks", ("regions", region.name), message, hint)
            elif clock != region.spec.clock:
                yield from _buses(region, port, clock)


def _buses(region: RegionPlan, port: str, clock: str) -> Iterator[Finding]:
    for interface in region.boundary.interfaces:
        connected = region.spec.interfaces.get(interface.name)
        if interface.clock != port or (connected and connected.connect in ("none", "external")):
            continue
        message = f"{interface.name} runs on {port}, which gets {clock}; its decoupler runs on {region.spec.clock}"
        hint = f"give {port} the region's clock, or put a crossing into the module"
        yield Finding("BD 41-237", ("regions", region.name, "clocks", port), message, hint)
