# SPDX-License-Identifier: Apache-2.0
"""Merges the features of static part and module, placed and routed separately, and checks the result."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass

from cm.design.openflow.layout import Anchor, Layout, site_kind
from cm.design.openflow.routed import PASSED, Routed, feature_of, tile_of
from cm.formats.xray import Database, Feature

CLOCK = "cm_clock_buffer"
_PASSING = ("INT_", "HCLK_")


@dataclass(frozen=True, slots=True)
class Side:
    """One run: the features that nextpnr wrote, what it routed, whether it is the static part's."""

    features: frozenset[Feature]
    routed: Routed
    static: bool


def static_features(database: Database, layouts: Iterable[Layout], side: Side) -> frozenset[Feature]:
    """The static part's features: all outside the regions, and in them only anchors and wires that pass through."""
    _, dropped = _pips(database, side.routed)
    regions = list(layouts)
    inside = {name for layout in regions for name in layout.tiles}
    own = {feature for feature in side.features if feature.tile not in inside}
    # also leaves of the clock: a column of the static part may get its clock from the next column
    passing = {feature for feature in side.features if feature.tile in inside and feature.tile.startswith(_PASSING)}
    own |= passing - dropped
    own |= _through(database, side, inside)
    return frozenset(own | {f for layout in regions for f in _anchored(layout, side)})


def module_features(database: Database, layout: Layout, side: Side) -> frozenset[Feature]:
    """The features that a module adds: its region's tiles, without the harness."""
    _, dropped = _pips(database, side.routed)
    taken = {tile.name for tile in layout.anchor_tiles}
    own = {f for f in side.features if f.tile in layout.tiles and f.tile not in taken} - dropped
    return frozenset(own | _through(database, side, taken) | set(_anchored(layout, side)))


def _through(database: Database, side: Side, tiles: set[str]) -> set[Feature]:
    """Features of look-up tables that the design is routed through, in tiles whose logic is left out."""
    kept, _ = side.routed.pips()
    wanted = set()
    for pip, _wire in kept:
        found = PASSED.fullmatch(pip.partition("/")[2])
        tile = tile_of(database, pip.partition("/")[0])
        if found is None or tile not in tiles:
            continue
        number = int(found[1].endswith("_L"))  # LL and M are the left site of a tile
        site = f"{site_kind(database.tiles[tile], number)}_X{number}"
        wanted.add(f"{tile}.{site}.{found[2]}{'OUTMUX' if found[3] else 'LUT'}.")
    starts = tuple(wanted)
    return {feature for feature in side.features if str(feature).startswith(starts)}


def strays(database: Database, layout: Layout, side: Side, static: frozenset[Feature]) -> list[str]:
    """Sentences about a module's routes outside its region; its clock may take the static part's route."""
    found = []
    for name, net in side.routed.nets.items():
        if any(cell.endswith(CLOCK) for cell, _, _ in net["users"]):
            continue  # to the clock buffer, which belongs to the static part
        clock = net["driver"].endswith(CLOCK)
        for pip in side.routed.pips_of(net):
            feature = feature_of(database, pip)
            if feature is None or feature.tile in layout.tiles or feature in static:
                continue
            if not _has_bits(database, feature):
                continue  # connections between tiles that cannot be switched
            what = "the clock takes another route than in the static part" if clock else f"net {name} leaves the region"
            found.append(f"{what}: {feature}")
    return found


def left_out(database: Database, side: Side, features: frozenset[Feature], tiles: Container[str]) -> list[str]:
    """Sentences about switches in these tiles that a side needs but that are missing from its features."""
    kept, _ = _pips(database, side.routed)
    missing = sorted(
        one for one in kept - features if one.tile in tiles and one in side.features and _has_bits(database, one)
    )
    return [f"{one} is needed, and is left out of the bitstream" for one in missing]


def _has_bits(database: Database, feature: Feature) -> bool:
    tile = database.tiles[feature.tile]
    return any(feature.name in database.segbits(segment.kind, segment.block).features for segment in tile.segments)


def _pips(database: Database, routed: Routed) -> tuple[frozenset[Feature], frozenset[Feature]]:
    """The features of pips that the design needs, and of those that only the harness needs."""
    kept, dropped = (
        frozenset(feature for pip, _ in pips if (feature := feature_of(database, pip))) for pips in routed.pips()
    )
    return kept, dropped - kept


def _anchored(layout: Layout, side: Side) -> Iterator[Feature]:
    """Features of each anchor: its look-up table if this side drives it, and its output if this side reads it."""
    sides = {(anchor.tile.name, anchor.site_name, anchor.letter): anchor for anchor in layout.anchors}
    names = {anchor.tile.name for anchor in layout.anchors}
    for feature in side.features:
        if feature.tile not in names:
            continue
        site, _, rest = feature.name.partition(".")
        anchor = sides.get((feature.tile, site, rest[:1]))
        if anchor is not None and _belongs(anchor, rest[1:], side):
            yield feature


def _belongs(anchor: Anchor, what: str, side: Side) -> bool:
    gives_input = anchor.bit.into == side.static
    return gives_input if what.startswith("LUT") else what.startswith("OUTMUX") and not gives_input
