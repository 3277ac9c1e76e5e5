# SPDX-License-Identifier: Apache-2.0
"""Writes a partition as a build schema: with the proposed regions, and everything else as before.

Whatever depends on the regions is rewritten: the regions of modules, the interfaces of the new
boundaries (their streams get different names, since each has its own DMA channel), and the modes. A region
whose modules stay together keeps its pblock; the others get ``auto`` and the resources that they need.

Proposals that can be generated: if the planner or a check refuses a partition, one with fewer regions is tried.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import yaml

from cm.design.boundary.analyse import Analysis
from cm.design.boundary.make import boundary
from cm.design.boundary.model import Boundary
from cm.design.check.rules import check_system
from cm.design.errors import BuildError
from cm.design.hdl.model import unique
from cm.design.partition.advisor import SECONDS, advise
from cm.design.partition.from_project import by_port, unit_name
from cm.design.partition.model import Group, Partition, Problem
from cm.design.partition.stream_names import Streams, streams_of
from cm.design.parts import device_of
from cm.design.plan.floorplan import CLOCK_REGION, device_sites, holds, rectangle
from cm.design.plan.planner import plan_system
from cm.design.platforms import platform_of
from cm.design.project.load import load_project, project_data
from cm.design.project.model import Project
from cm.schema.problems import SchemaError

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
    new = boundary({module: analysis.modules[module] for module, _ in members})
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


_HEAD = """\
# yaml-language-server: $schema=build.schema.json
# What `cm build partition` proposes: {name} with other regions. New regions have `pblock: auto`.
# Where one stream has become several, each has a new name, which programs have to use.
"""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A partition that can be generated, as the text of a build schema; `notes`: what was refused before it."""

    partition: Partition
    text: str
    notes: tuple[str, ...] = ()


def proposal(
    project: Project, analysis: Analysis, problem: Problem, objective: str = "worst", seconds: float = SECONDS
) -> Proposal:
    """Return the best partition that can be generated. Raises BuildError if there is none.

    `seconds` is the limit of all searches together, but each gets at least one second.
    """
    data = project_data(project.source)
    notes: list[str] = []
    end = time.monotonic() + seconds
    while True:
        found = advise(problem, objective, max(1.0, end - time.monotonic()))
        text = schema_text(project.source.name, propose(project, data, analysis, found))
        refused = refusals(project, analysis, text)
        if not refused:
            return Proposal(found, text, tuple(notes))
        count = len(found.groups)
        if count == 1:
            raise BuildError("no partition can be generated; the last one:\n  " + "\n  ".join(refused))
        notes.append(f"{count} regions cannot be generated: {refused[0]}")
        problem = replace(problem, regions=count - 1)


def schema_text(name: str, data: Mapping[str, Any]) -> str:
    """Write data as the text of a build schema."""
    body: str = yaml.safe_dump(dict(data), sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)
    return _HEAD.format(name=name) + "\n" + body


def refusals(project: Project, analysis: Analysis, text: str) -> list[str]:
    """Return why the build schema `text`, with the modules of `project`, cannot be generated; empty if it can."""
    try:
        other = load_project(project.source, text)
        boundaries = {
            name: boundary({m.name: analysis.modules[m.name] for m in other.modules_of(name)}, region.interfaces)
            for name, region in other.regions.items()
        }
        changed = replace(analysis, boundaries=boundaries)
        if changed.refused:
            return list(changed.refused)
        found = check_system(plan_system(changed.completed(other), boundaries))
    except SchemaError as error:
        return [problem.message for problem in error.problems]
    except BuildError as error:
        return [str(error)]
    return [f"{finding.message} [{finding.rule}]" for finding in found if finding.error]
