# SPDX-License-Identifier: Apache-2.0
"""Relocatable modules: whether their regions have the first one's shape, and bitstreams for them, made of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from cm.design.errors import BuildError
from cm.design.generate.wrapper import black_box
from cm.design.openflow.images import neighbours
from cm.design.openflow.job import shape
from cm.design.openflow.layout import Layout, layouts
from cm.design.plan.system import Implementation, RegionPlan, System
from cm.design.project.source_position import OPEN_FLOW, Finding, fault
from cm.formats.bitstream import device_by_name, merge, relocate
from cm.formats.bitstream.errors import CannotRelocate
from cm.formats.bitstream.geometry import decode_far
from cm.formats.bitstream.idcodes import Family
from cm.formats.xray import Database, DatabaseMissing
from cm.formats.xray.frames import Frames
from cm.schema.model import FrameRange

MOVERS = (merge.__file__, relocate.__file__)  # what a moved bitstream comes of, besides its origin
_HINT = "leave the region out of its regions, or relocatable"


def moves_of(system: System, places: Mapping[str, Layout], database: Database) -> dict[str, merge.Moves]:
    """How columns of each moved implementation become the other region's, by its name.

    Raises BuildError, at the module's key, for a region that is not as the first one.
    """
    found = {}
    for origin, one in system.moved:
        try:
            check_ports(origin.region, one.region)
            found[one.name] = moves_between(system, places[origin.region.name], places[one.region.name], database)
        except CannotRelocate as problem:
            raise fault(system.project.source, _key(one), _sentence(origin, one, problem), _HINT) from None
    return found


def moves_between(system: System, source: Layout, target: Layout, database: Database) -> merge.Moves:
    """Where each column of a region lies in another. Raises CannotRelocate with the first difference."""
    device = device_by_name(system.device)
    assert device is not None  # refused before, as one that nextpnr has no data of
    moves = relocate.column_moves(device, _ranges(source.columns), _ranges(target.columns))
    merge.check_kinds(database, moves)
    if shape(source) != shape(target):
        raise CannotRelocate("the columns are the same, but not as far from each other")
    return moves


def check_ports(source: RegionPlan, target: RegionPlan) -> None:
    """Raise CannotRelocate at the first port in which two boundaries differ. Anchors go by the order of ports."""
    here, there = (
        {port.name: " ".join(port.declaration.split()) for port in black_box(region).ports}
        for region in (source, target)
    )
    for name in here | there:
        if here.get(name) != there.get(name):
            own, other = (ports.get(name, f"no {name}") for ports in (here, there))
            raise CannotRelocate(
                f"{source.name} has {own} at its boundary, {target.name} has {other}; all modules of a region add to it"
            )
    for one, other in zip(here, there, strict=True):
        if one != other:
            raise CannotRelocate(f"where {source.name} has {one} at its boundary, {target.name} has {other}")


def moved_image(
    origin: Implementation, one: Implementation, made: bytes, moves: merge.Moves, blank: Frames, database: Database
) -> bytes:
    """The bitstream of an implementation, made of its origin's. Raises CannotRelocate with the first difference."""
    try:
        return relocate.relocate(made, moves, blank, database)
    except CannotRelocate as problem:
        raise CannotRelocate(f"{_sentence(origin, one, problem)} (another --seed may help, or {_HINT})") from None


def check_moved(system: System) -> Iterator[Finding]:
    """Findings about each region that a relocatable module is moved to: an error where it does not fit, else a note.

    `system` is one of which `check_open` finds no errors.
    """
    if not system.moved:
        return
    unknown = ""
    try:
        database = Database.open(system.project.part)
        places = layouts(system, database)
    except DatabaseMissing as problem:
        unknown = str(problem)
    except BuildError as problem:
        yield Finding(OPEN_FLOW, ("regions",), str(problem))
        return
    for origin, one in system.moved:
        home, region = origin.region, one.region
        known = f"{region.name} has the shape of {home.name}"
        if unknown:
            known = f"whether {known} is not known, {unknown}"
        try:
            check_ports(home, region)
            if not unknown:
                moves_between(system, places[home.name], places[region.name], database)
        except CannotRelocate as problem:
            yield Finding(OPEN_FLOW, _key(one), _sentence(origin, one, problem), _HINT)
            continue
        told = f"{one.name}.bit is made of {origin.name}.bit: {known}"
        yield Finding("relocatable", _key(one), told, error=False)


def _key(one: Implementation) -> tuple[str | int, ...]:
    return ("modules", one.module.name, "regions", one.module.regions.index(one.region.name))


def _sentence(origin: Implementation, one: Implementation, problem: Exception) -> str:
    return f"{one.module.name} cannot be moved from {origin.region.name} to {one.region.name}: {problem}"


def _ranges(columns: Iterable[int]) -> list[FrameRange]:
    """Columns (frame addresses without the minor part) as runs of neighbours in a row."""
    found = []
    for first, many in neighbours(sorted(columns)):
        at = decode_far(first << 7, Family.SERIES7)
        found.append(FrameRange(at.block_type, at.row, at.column, at.column + many - 1))
    return found
