# SPDX-License-Identifier: Apache-2.0
"""The place of a region on the device, and the places where the wires of its boundary cross into it.

A wire crosses through a look-up table, its anchor, at a place that the static part and all modules know: the static
part is routed to one side of it, each module to the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from cm.design.errors import BuildError
from cm.design.generate.verilog_module import Signal
from cm.design.generate.wrapper import black_box
from cm.design.hdl.model import PortDirection
from cm.design.plan.floorplan import rectangle
from cm.design.plan.system import RegionPlan, System
from cm.formats.xray import Database, Tile

LETTERS = "ABCD"
_KINDS = ("SLICE", "RAMB18", "RAMB36", "DSP48")


@dataclass(frozen=True, slots=True)
class BoundaryBit:
    """One wire of a boundary: bit `bit` of port `port`; `into` the region, or out of it."""

    region: int  # its index
    index: int
    port: str
    bit: int
    width: int
    into: bool

    @property
    def label(self) -> str:
        """A name that is unique among all wires of all regions."""
        return f"{self.region}_{self.index}"

    @property
    def signal(self) -> str:
        """The wire in Verilog."""
        return self.port if self.width == 1 else f"{self.port}[{self.bit}]"


@dataclass(frozen=True, slots=True)
class Anchor:
    """The place of a wire's anchor: tile, site in the tile (0 left, 1 right), letter of the look-up table."""

    bit: BoundaryBit
    tile: Tile
    site: int
    letter: str

    @property
    def bel(self) -> str:
        """The name that nextpnr uses."""
        return f"X{self.tile.x}Y{self.tile.y}/SLICE_X{self.site}Y0.{self.letter}6LUT"

    @property
    def site_name(self) -> str:
        """The name that features use: ``SLICEL_X0``."""
        return f"{site_kind(self.tile, self.site)}_X{self.site}"


@dataclass(frozen=True)
class Layout:
    """A region on the device: its tiles by name, the columns of frames it owns, its anchors."""

    region: RegionPlan
    tiles: dict[str, Tile]
    columns: frozenset[int]  # frame addresses without the minor part
    anchors: tuple[Anchor, ...]
    anchor_tiles: tuple[Tile, ...]

    @cached_property
    def logic_tiles(self) -> tuple[Tile, ...]:
        """The tiles with sites that a module may use."""
        taken = {tile.name for tile in self.anchor_tiles}
        return tuple(tile for tile in self.tiles.values() if tile.sites and tile.name not in taken)


def boundary_bits(region: RegionPlan, ports: Sequence[Signal]) -> tuple[BoundaryBit, ...]:
    """All wires of a region's boundary except its clocks, in the order of its ports."""
    clocks = set(region.clocks)
    wires = [(port, bit) for port in ports if port.name not in clocks for bit in range(port.width)]
    return tuple(
        BoundaryBit(region.index, index, port.name, bit, port.width, port.direction is PortDirection.IN)
        for index, (port, bit) in enumerate(wires)
    )


def site_kind(tile: Tile, number: int) -> str:
    """SLICEL or SLICEM: the kind of a tile's left (0) or right (1) slice."""
    return [tile.sites[name] for name in sorted(tile.sites, key=_site_column)][number]


def layouts(system: System, database: Database | None = None) -> dict[str, Layout]:
    """The layout of every region, by name. Raises BuildError, DatabaseMissing."""
    data = database or Database.open(system.project.part)
    return {
        region.name: plan_layout(data, region, boundary_bits(region, black_box(region).ports))
        for region in system.regions
    }


def plan_layout(database: Database, region: RegionPlan, bits: Sequence[BoundaryBit]) -> Layout:
    """Place a region and its anchors. Raises BuildError if its pblock cannot hold them."""
    sites = _sites(database, region)
    columns = frozenset(
        segment.base >> 7 for tile in database.tiles.values() if sites & tile.sites.keys() for segment in tile.segments
    )
    tiles = {
        tile.name: tile
        for tile in database.tiles.values()
        if any(segment.base >> 7 in columns for segment in tile.segments)
    }
    beside = sorted(name for tile in tiles.values() for name in tile.sites if _counts(tile, name) and name not in sites)
    if beside:
        raise BuildError(
            f"region {region.name}: its frames hold {beside[0]} too; give it whole clock regions in height, and whole "
            f"columns (both slices of a tile) with their RAMB18 and RAMB36"
        )
    first = min(tile.x for tile in tiles.values() if tile.kind.startswith("CLB"))
    column = sorted((tile for tile in tiles.values() if tile.x == first), key=lambda tile: tile.y)
    if len(bits) > 4 * len(column):
        raise BuildError(
            f"region {region.name}: {len(bits)} wires cross its boundary, the first column of its pblock has room "
            f"for {4 * len(column)}: make it higher, or its interfaces narrower"
        )
    return Layout(region, tiles, columns, _anchors(bits, column), tuple(column))


def _anchors(bits: Sequence[BoundaryBit], column: Sequence[Tile]) -> tuple[Anchor, ...]:
    """Spread anchors over the whole height: crowded rows are hard to route."""
    rows = -(-len(bits) // len(LETTERS))
    chosen = [column[row * len(column) // rows] for row in range(rows)]
    return tuple(Anchor(bit, chosen[bit.index // 4], 0, LETTERS[bit.index % 4]) for bit in bits)


def _sites(database: Database, region: RegionPlan) -> set[str]:
    """The names of all sites of a pblock that the device has."""
    named = set()
    for text in region.spec.pblock:
        area = rectangle(text)
        if area is None or area.kind not in _KINDS:
            continue
        for x in range(area.left, area.right + 1):
            named |= {f"{area.kind}_X{x}Y{y}" for y in range(area.bottom, area.top + 1)}
    there = {name for tile in database.tiles.values() for name in tile.sites}
    return named & there


def _counts(tile: Tile, site: str) -> bool:
    return tile.kind.startswith(("CLB", "BRAM", "DSP")) and site.partition("_X")[0] in _KINDS


def _site_column(name: str) -> int:
    return int(name.partition("_X")[2].partition("Y")[0])
