# SPDX-License-Identifier: Apache-2.0
"""Writes a partition as a build schema: with the proposed regions, and everything else as before.

Whatever depends on the regions is rewritten: the regions of modules, the interfaces of the new
boundaries (their streams get different names, since each has its own DMA channel), and the modes. A region
whose modules stay together keeps its pblock; the others get ``auto`` and the resources that they need.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from cm.design.boundary import boundary
from cm.design.boundary.analyse import Analysis
from cm.design.boundary.model import Boundary
from cm.design.boundary.slots import unique
from cm.design.partition.advise import unit_name
from cm.design.partition.external import by_port
from cm.design.partition.model import Group, Partition
from cm.design.partition.streams import Streams, streams_of
from cm.design.plan.floorplan import CLOCK_REGION, device_sites, holds, rectangle
from cm.design.platforms import device_of, platform_of
from cm.design.project.model import Project

Place = tuple[str, str]  # module, present region
_REMADE = ("pblock", "resources", "interfaces", "doc")


def propose(project: Project, data: Mapping[str, Any], analysis: Analysis, found: Partition) -> dict[str, Any]:
    """Return the data of a build schema with the regions of `found`; `data`: that of `project`."""
    members = _named(project, found)
    kept = {name for name, places in members.items() if set(places) == _today(project).get(name)}
    streams = Streams(streams_of(project, analysis), kept)
    text: dict[str, Any] = copy.deepcopy(dict(data))
    text["regions"] = {
        name: _kept(project, data, name, group)
        if name in kept
        else _region(data, analysis, name, members[name], group, streams)
        for name, group in zip(members, found.groups, strict=True)
    }
    now = {place: name for name, places in members.items() for place in places}
    for module, spec in text["modules"].items():
        spec.pop("regions", None)
        if len(members) > 1:
            spec["regions"] = list(dict.fromkeys(now[module, r] for r in project.modules[module].regions))
    _modes(project, text, now, streams)
    return text


def _kept(project: Project, data: Mapping[str, Any], name: str, group: Group) -> dict[str, Any]:
    """Keep a present region, and its place if that is large enough for its modules."""
    spec = dict(data["regions"][name] or {})
    areas = [area for area in map(rectangle, project.regions[name].pblock) if area]
    room = holds(areas, device_sites(device_of(project.part)), platform_of(project.part).ultrascale)
    counted = areas and not any(area.kind == CLOCK_REGION for area in areas)
    if counted and room.largest(group.resources) != room:
        spec |= {"pblock": ["auto"], "resources": _resources(group)}
    elif not areas:
        spec.setdefault("resources", _resources(group))
    return spec


def _resources(group: Group) -> dict[str, float]:
    needs = zip(("lut", "ff", "bram", "dsp"), group.resources.values(), strict=True)
    return {key: value for key, value in needs if value}


def _modes(project: Project, text: dict[str, Any], now: Mapping[Place, str], streams: Streams) -> None:
    if not text.get("modes"):
        text.pop("default_mode", None)
        return
    for name, spec in text["modes"].items():
        mode = project.modes[name]
        spec["modules"] = {now[module, region]: module for region, module in mode.modules.items()}
        spec["streams"] = streams.of_mode(mode)
        if not spec["streams"]:
            del spec["streams"]


def _today(project: Project) -> dict[str, set[Place]]:
    return {region: {(m.name, region) for m in project.modules_of(region)} for region in project.regions}


def _named(project: Project, found: Partition) -> dict[str, list[Place]]:
    """Name each group: by its present region, or by a name made from that of its first module."""
    places = {unit_name(m, region): (m.name, region) for m in project.modules.values() for region in m.regions}
    groups = [[places[name] for name in group.modules] for group in found.groups]
    today = _today(project)
    own = {region for region, members in today.items() if members in [set(group) for group in groups]}
    named: dict[str, list[Place]] = {}
    for group in groups:
        kept = next((region for region in own if today[region] == set(group)), None)
        named[kept or unique(group[0][1], {*named, *own})] = group
    return named


def _region(
    data: Mapping[str, Any], analysis: Analysis, name: str, members: Sequence[Place], group: Group, streams: Streams
) -> dict[str, Any]:
    olds = {region: data["regions"][region] or {} for _, region in members}
    first = olds[members[0][1]]
    spec = {key: copy.deepcopy(value) for key, value in first.items() if key not in _REMADE}
    windows = [old["window"] for old in olds.values() if "window" in old]
    if windows:
        spec["window"] = max(windows)
    spec["pblock"] = ["auto"]
    spec["resources"] = _resources(group)
    modules = list(dict.fromkeys(module for module, _ in members))
    new = boundary([analysis.modules[module] for module in modules], labels=modules)
    interfaces: dict[str, Any] = {}
    for module, region in members:
        for now, before in _same(module, new, analysis.boundaries[region]).items():
            streams.move(module, (region, before), (name, now))
            if now not in interfaces:
                given = (olds[region].get("interfaces") or {}).get(before)
                interfaces[now] = streams.connect(given, (region, before), (name, now))
    spec["interfaces"] = {key: value for key, value in interfaces.items() if value}
    return spec


def _same(module: str, new: Boundary, old: Boundary) -> dict[str, str]:
    """Map interfaces and single ports of `new` to those of `old` that belong to the same port of `module`."""
    before = by_port(module, old)
    return {name: before[port] for port, name in by_port(module, new).items() if port in before}
