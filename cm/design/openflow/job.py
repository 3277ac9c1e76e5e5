# SPDX-License-Identifier: Apache-2.0
"""The input of nextpnr besides the netlist: places, areas, pins, and wires that are taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from cm.design.openflow.layout import Layout
from cm.design.openflow.netlists import ANCHOR, HARNESS
from cm.design.openflow.rewrites import Cell, shares
from cm.design.openflow.routed import PASSED, Routed, tile_of
from cm.design.plan.pins import Placement
from cm.formats.xray import Database, Feature, Tile, Wires

Job = dict[str, Any]
_INTO_SLICES = ("BYP", "FAN", "IMUX", "CTRL", "CLK", "GFAN")
_ROUTING = ("INT_L", "INT_R")
_LEAF = "HCLK_LEAF_CLK_"
_STATIC, _MODULE = "static", "module"  # areas


def static_job(database: Database, layouts: Sequence[Layout]) -> Job:
    """Keep the static part out of the regions, except for its anchors and harnesses."""
    inside = {name for layout in layouts for name in layout.tiles}
    areas = {_harness(layout): _harness_places(layout) for layout in layouts}
    areas[_STATIC] = [_at(tile) for tile in database.tiles.values() if tile.sites and tile.name not in inside]
    cells = [[_harness(layout), _harness(layout)] for layout in layouts] + [["", _STATIC]]
    return {"bels": _anchor_bels(layouts), "areas": areas, "cells": cells, "blocked": []}


def module_job(
    database: Database, wires: Wires, layout: Layout, static: Routed, features: Iterable[Feature], clock_buffer: str
) -> Job:
    """Keep a module inside its region and away from what the static part uses there."""
    passed = passing(database, wires, layout, static)
    areas = {_harness(layout): _free_places(layout, passed), _MODULE: [_at(tile) for tile in layout.logic_tiles]}
    bels = [*_anchor_bels([layout]), ["cm_clock_buffer", clock_buffer]]
    blocked = fence(database, wires, layout) | passed
    blocked |= other_lanes(database, wires, layout, features)
    cells = [[_harness(layout), _harness(layout)], ["", _MODULE]]
    return {"bels": bels, "areas": areas, "cells": cells, "blocked": sorted(blocked)}


def with_cells(job: Job, cells: Mapping[str, Cell], database: Database, what: str) -> Job:
    """A job with what it has to know of the netlist's cells: where those that are written may be, by the enable."""
    (area,) = {_STATIC, _MODULE} & job["areas"].keys()
    own = set(job["areas"][area])
    kept = shares(cells, [tile for tile in database.tiles.values() if tile.sites and _at(tile) in own], what)
    return {**job, "areas": {**job["areas"], **kept.areas}, "own_areas": kept.cells}


def without(job: Job, wires: set[str]) -> Job:
    """A job that must leave further wires alone."""
    return {**job, "blocked": sorted({*job["blocked"], *wires})} if wires else job


def fence(database: Database, wires: Wires, layout: Layout) -> set[str]:
    """Wires that begin in a region and can be tapped outside it; blocking them confines routes to the region."""
    found = set()
    for tile in layout.tiles.values():
        if not tile.kind.startswith("INT_"):
            continue
        for wire in {pip.destination for pip in wires.kind(tile.kind).pips.values()}:
            node = wires.node(tile.name, wire)
            if any(name not in layout.tiles and database.tiles[name].kind in _ROUTING for name, _ in node):
                found.add(f"{_at(tile)}/{wire}")
    return found


def passing(database: Database, wires: Wires, layout: Layout, static: Routed) -> set[str]:
    """Wires of the static part that touch the region.

    Excluded are wires that only one look-up table can drive, since an anchor's output is used by the static part
    and also, in a module's run, by the harness; and the clock's, which the module shares.
    """
    kept, _ = static.pips()
    found = set()
    for pip, wire in kept:
        place, _, name = wire.partition("/")
        if PASSED.fullmatch(pip.partition("/")[2]):
            found.add(wire)  # a look-up table that the static part routes through
            continue
        tile = tile_of(database, place)
        if tile is None or "." in name or "LOGIC_OUTS" in name or tile.startswith(("CLB", "HCLK", "CLK")):
            continue
        if any(there in layout.tiles for there, _ in wires.node(tile, name)):
            found.add(wire)
    return found


def elsewhere(database: Database, wires: Wires, layout: Layout, others: Iterable[Layout], static: Routed) -> set[str]:
    """Wires not to be used in other regions of the same shape, as they are called in this one.

    The static part takes them there, or they lead out of the region: at the edge of the device they turn back.
    """
    found = set()
    for other in others:
        if shape(other) != shape(layout):
            continue
        (left, top), (x, y) = _corner(other), _corner(layout)
        for wire in passing(database, wires, other, static) | fence(database, wires, other):
            place, _, name = wire.partition("/")
            across, down = map(int, place[1:].split("Y"))
            one, its = (database.tile_at.get(at) for at in ((across, down), (across - left + x, down - top + y)))
            if one and its and one.kind == its.kind:
                found.add(f"{_at(its)}/{name}")
    return found


def _corner(layout: Layout) -> tuple[int, int]:
    return min(tile.x for tile in layout.tiles.values()), min(tile.y for tile in layout.tiles.values())


def shape(layout: Layout) -> set[tuple[str, int, int]]:
    """The kinds of a region's tiles, and where they lie in it."""
    x, y = _corner(layout)
    return {(tile.kind, tile.x - x, tile.y - y) for tile in layout.tiles.values()}


def other_lanes(database: Database, wires: Wires, layout: Layout, static: Iterable[Feature]) -> set[str]:
    """Lanes into the clock rows, and leaves outside the region, that the static part does not switch on.

    A module's clock must take the same ones: the frames that switch them do not belong to the module. A leaf between
    two regions is the other's, though its harness may use it: what counts is the features of the static part.
    """
    kinds = {"CLK_HROW_": "CLK_HROW_CK_MUX_OUT_", "HCLK_L": _LEAF, "HCLK_R": _LEAF}
    switched = {(tile, name.partition(".")[0]) for tile, name in static}
    return {
        f"{_at(tile)}/{wire}"
        for tile in database.tiles.values()
        for kind, start in kinds.items()
        if tile.kind.startswith(kind) and tile.name not in layout.tiles
        for wire in wires.kind(tile.kind).wires
        if wire.startswith(start) and (tile.name, wire) not in switched
    }


def pins_xdc(placements: Iterable[Placement]) -> str:
    """Package pins as nextpnr reads them."""
    lines = []
    for one in placements:
        target = f"{{{one.target}}}" if "[" in one.target else one.target
        lines.append(f"set_property LOC {one.pin.location} [get_ports {target}]")
        lines.append(f"set_property IOSTANDARD {one.pin.iostandard} [get_ports {target}]")
    return "".join(f"{line}\n" for line in lines)


def labels(layouts: Iterable[Layout]) -> Mapping[bool, frozenset[str]]:
    """The labels of all anchors, by whether they lead into a region."""
    anchors = [anchor for layout in layouts for anchor in layout.anchors]
    return {into: frozenset(a.bit.label for a in anchors if a.bit.into == into) for into in (True, False)}


def _anchor_bels(layouts: Iterable[Layout]) -> list[list[str]]:
    return [[f"{ANCHOR}{anchor.bit.label}", anchor.bel] for layout in layouts for anchor in layout.anchors]


def _harness(layout: Layout) -> str:
    return f"{HARNESS}{layout.region.index}_"


def _harness_places(layout: Layout) -> list[str]:
    return [f"{_at(tile)}/SLICE_X1Y0" for tile in layout.anchor_tiles]


def _free_places(layout: Layout, passed: set[str]) -> list[str]:
    """Places whose routes into slices the static part does not use, which the placer does not consider.

    If too few are left, all places.
    """
    taken = {wire.partition("/")[0] for wire in passed if wire.partition("/")[2].startswith(_INTO_SLICES)}
    free = [
        f"{_at(tile)}/SLICE_X1Y0"
        for tile in layout.anchor_tiles
        if f"X{tile.x + (1 if tile.kind.endswith('_L') else -1)}Y{tile.y}" not in taken
    ]
    return free if 4 * len(free) >= len(layout.anchor_tiles) else _harness_places(layout)


def _at(tile: Tile) -> str:
    return f"X{tile.x}Y{tile.y}"
