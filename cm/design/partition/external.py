# SPDX-License-Identifier: Apache-2.0
"""Modules that share something outside their region, such as pins of the board."""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.boundary.analyse import Analysis
from cm.design.boundary.model import Boundary, Role
from cm.design.project.model import Project, RegionSpec

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
