# SPDX-License-Identifier: Apache-2.0
"""Pblocks: no overlaps, nothing in them that must stay static, and enough resources for their modules."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from cm.design.plan.floorplan import CLOCK_REGION, KINDS, Device, Rectangle, device_sites, holds, rectangle
from cm.design.plan.system import RegionPlan, System
from cm.design.project.model import Resources
from cm.design.project.source_position import Finding

_NAMES = (("lut", "LUT"), ("ff", "flip-flops"), ("bram", "block RAM (36 Kbit)"), ("dsp", "DSP"))


def check_floorplan(system: System) -> Iterator[Finding]:
    """Findings of all regions with ranges of their own."""
    device = device_sites(system.device)
    given = {r.name: [a for a in map(rectangle, r.spec.pblock) if a] for r in system.regions if r.spec.pblock}
    unfolded = {name: [part for area in areas for part in _parts(area, device)] for name, areas in given.items()}
    for region in system.regions:
        if region.name in given:
            yield from _kinds(region, given[region.name], system, device)
            yield from _room(region, unfolded[region.name], system, device)
    for one, other in combinations(given, 2):
        yield from _overlap(one, other, unfolded)


def _parts(area: Rectangle, device: Device | None) -> list[Rectangle]:
    return list(device.unfold(area)) if device else [area]


def _kinds(region: RegionPlan, areas: list[Rectangle], system: System, device: Device | None) -> Iterator[Finding]:
    allowed = KINDS[system.platform.ultrascale]
    for index, area in enumerate(areas):
        key = ("regions", region.name, "pblock", index)
        if area.kind not in (*allowed, CLOCK_REGION):
            message = f"{area.kind} sites cannot be reconfigured: they belong to the static part"
            yield Finding("UG909", key, message, f"ranges of {', '.join(allowed)} are possible")
        limits = device.limits(area.kind) if device and area.kind != CLOCK_REGION else None
        if limits and (area.right > limits.right or area.top > limits.top):
            yield Finding("site-range", key, f"{area} reaches beyond {system.device}", f"its sites are {limits}")
    kinds = {area.kind for area in areas}
    for have, lack in (("RAMB18", "RAMB36"), ("RAMB36", "RAMB18")):
        if have in kinds and lack not in kinds:
            message = f"the pblock has {have} sites but no {lack}: a memory of the other size has no place"
            yield Finding(
                "pblock-ram",
                ("regions", region.name, "pblock"),
                message,
                f"name the {lack} sites of the same columns too",
                error=False,
            )


def _room(region: RegionPlan, areas: list[Rectangle], system: System, device: Device | None) -> Iterator[Finding]:
    if any(area.kind == CLOCK_REGION for area in areas):
        return  # the contents of clock regions are not known for a device without public data
    have = holds(areas, device, system.platform.ultrascale)
    for what, need in _needs(region, system):
        for attribute, name in _NAMES:
            wanted, there = getattr(need, attribute), getattr(have, attribute)
            if wanted > there:
                message = f"{what} needs {wanted:g} {name}, the pblock of {region.name} has {there:g}"
                hint = _hint(attribute, there, system)
                rule = "DRC UTLZ-1" if there else "DRC HDPR-18"
                yield Finding(rule, ("regions", region.name, "pblock"), message, hint)


def _needs(region: RegionPlan, system: System) -> Iterator[tuple[str, Resources]]:
    if region.spec.resources:
        yield f"resources: of {region.name}", region.spec.resources
    for module in system.project.modules_of(region.name):
        yield f"module {module.name}", module.resources


def _hint(attribute: str, there: float, system: System) -> str:
    if there:
        return "make it larger"
    kind = {"dsp": KINDS[system.platform.ultrascale][1], "bram": "RAMB36"}.get(attribute, "SLICE")
    return f"add a range of {kind} sites of the same columns"


def _overlap(one: str, other: str, areas: dict[str, list[Rectangle]]) -> Iterator[Finding]:
    for mine in areas[one]:
        for theirs in areas[other]:
            if mine.meets(theirs):
                message = f"{mine} lies on {theirs} of region {one if mine is theirs else other}"
                yield Finding("overlap", ("regions", other, "pblock"), message.replace(f" of region {other}", ""),
                              f"{one} and {other} must not share a site")  # fmt: skip
                return
