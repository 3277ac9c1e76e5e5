# SPDX-License-Identifier: Apache-2.0
"""Wires: which wires of neighbouring tiles form one node, and the pips that join nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import NamedTuple

from cm.formats.xray.database import Database
from cm.formats.xray.features import Feature
from cm.formats.xray.tiles import Tile
from cm.frozen import dataclass

Wire = tuple[str, str]  # tile, name of the wire in it
_Joints = dict[tuple[int, int], dict[str, list[str]]]  # (dx, dy) → kind of the tile there → its wires


class Pip(NamedTuple):
    """A switch of a kind of tile from wire `source` to wire `destination`.

    Its feature is `DESTINATION.SOURCE`. A pseudo pip is a way through a site, set by the site's features.
    """

    source: str
    destination: str
    both_ways: bool
    pseudo: bool

    @property
    def feature(self) -> str:
        """Its name in FASM, without the tile."""
        return f"{self.destination}.{self.source}"


@dataclass(frozen=True, slots=True)
class SitePins:
    """A site of a kind of tile: its type (``SLICEM``), prefix (``SLICE``), place in the tile, and wire by pin."""

    type: str
    prefix: str
    x: int
    y: int
    pins: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of tile: its wires, its pips by feature, its sites."""

    wires: frozenset[str]
    pips: Mapping[str, Pip]
    sites: tuple[SitePins, ...]


class Wires:
    """The wires of a part. Answers are cached."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._kinds: dict[str, Kind] = {}
        self._nodes: dict[Wire, frozenset[Wire]] = {}

    def kind(self, name: str) -> Kind:
        """A kind of tile, such as ``INT_L``. Raises XrayError."""
        if name not in self._kinds:
            found = self._database.json(f"tile_type_{name}.json")
            pips = (
                Pip(pip["src_wire"], pip["dst_wire"], pip["is_directional"] == "0", pip["is_pseudo"] == "1")
                for pip in found["pips"].values()
            )
            sites = tuple(
                SitePins(
                    site["type"],
                    site["prefix"],
                    site["x_coord"],
                    site["y_coord"],
                    {pin: detail["wire"] for pin, detail in site["site_pins"].items() if detail},
                )
                for site in found["sites"]
            )
            self._kinds[name] = Kind(frozenset(found["wires"]), {pip.feature: pip for pip in pips}, sites)
        return self._kinds[name]

    def node(self, tile: str, wire: str) -> frozenset[Wire]:
        """All wires, in any tile, that are the same piece of metal as this one; itself among them."""
        start = (tile, wire)
        if start not in self._nodes:
            found = self._reach(start)
            self._nodes.update(dict.fromkeys(found, found))
        return self._nodes[start]

    def _reach(self, start: Wire) -> frozenset[Wire]:
        found, todo = {start}, [start]
        while todo:
            tile, wire = todo.pop()
            here = self._database.tiles[tile]
            for neighbour in self._neighbours(here, wire):
                if neighbour not in found:
                    found.add(neighbour)
                    todo.append(neighbour)
        return frozenset(found)

    def _neighbours(self, tile: Tile, wire: str) -> list[Wire]:
        found = []
        at = self._database.tile_at
        for (dx, dy), others in self._joints.get((tile.kind, wire), {}).items():
            there = at.get((tile.x + dx, tile.y + dy))
            if there is not None:
                found += [(there.name, other) for other in others.get(there.kind, ())]
        return found

    @cached_property
    def _joints(self) -> Mapping[tuple[str, str], _Joints]:
        """For a wire of a kind of tile: what it may be joined to."""
        joints: dict[tuple[str, str], _Joints] = {}
        for entry in self._database.json(f"{self._database.fabric}/tileconn.json"):
            (one, two), (dx, dy) = entry["tile_types"], entry["grid_deltas"]
            for wire_one, wire_two in entry["wire_pairs"]:
                for here, wire, delta, kind, other in (
                    (one, wire_one, (dx, dy), two, wire_two),
                    (two, wire_two, (-dx, -dy), one, wire_one),
                ):
                    beside = joints.setdefault((here, wire), {}).setdefault(delta, {})
                    beside.setdefault(kind, []).append(other)
        return joints


def two_drivers(database: Database, features: Iterable[Feature]) -> list[str]:
    """Sentences about wires that are driven by two pips."""
    wires = Wires(database)
    drivers: dict[tuple[str, str], Feature] = {}
    found = []
    for feature in sorted(features):
        if not feature.tile.startswith("INT_"):
            continue
        wire = feature.name.partition(".")[0]
        node = min(wires.node(feature.tile, wire))
        other = drivers.setdefault(node, feature)
        if other != feature:
            found.append(f"{feature.tile}.{wire} has two drivers: {other} and {feature}")
    return found
