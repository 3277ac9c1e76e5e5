# SPDX-License-Identifier: Apache-2.0
"""What nextpnr routed: which routes belong to the design, and which only to the harness behind the anchors."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.design.openflow.netlists import ANCHOR, HARNESS
from cm.formats.xray import Database, Feature

_TABLE_PIN = re.compile(r"(X\d+Y\d+/SLICE_X\dY0)\.([A-D])([1-6])")
_ONES = "$PACKER_VCC_NET"
# A route through a look-up table, from an input (without its number if it goes on to the multiplexer) to the output.
PASSED = re.compile(r"(CLBL[LM]_(?:LL|L|M))_([A-D])(MUX)?/\1_\2[1-6]?")
Pip = tuple[str, str]  # name in nextpnr (X85Y13/DESTINATION/SOURCE), name of the wire it drives


@dataclass(frozen=True)
class Routed:
    """The dump of `nextpnr_scripts/dump.py`; `inputs`: labels of the anchors whose input side this run contains."""

    cells: Mapping[str, tuple[str, str]]  # name → type, place
    nets: Mapping[str, Mapping[str, Any]]
    inputs: frozenset[str]

    def place(self, own: str) -> str:
        """The place of the cell whose own name is `own`."""
        return next(place for name, (_, place) in self.cells.items() if last(name) == own)

    def own(self, cell: str) -> bool:
        """Whether a route to this cell belongs to the design."""
        own = last(cell)
        if own.startswith(HARNESS):
            return False
        return not own.startswith(ANCHOR) or own.removeprefix(ANCHOR) in self.inputs

    def pips(self) -> tuple[frozenset[Pip], frozenset[Pip]]:
        """The pips that the design needs, and those that only the harness needs."""
        kept: set[Pip] = set()
        every: set[Pip] = set()
        for net in self.nets.values():
            every |= {(way[0], wire) for wire, way in net["wires"].items() if way}
            kept |= self._needed(net)
        return frozenset(kept), frozenset(every - kept)

    def pips_of(self, net: Mapping[str, Any]) -> frozenset[str]:
        """The names of the pips of a net that the design needs."""
        return frozenset(pip for pip, _ in self._needed(net))

    def lost(self) -> list[str]:
        """Sentences about inputs of the design that their net does not reach; an unrouted input reads as 1."""
        return [
            f"net {name} does not reach pin {port} of {cell}"
            for name, net in self.nets.items()
            if net["driver"] and name != _ONES and not last(net["driver"]).startswith(HARNESS) and net["wires"]
            for cell, port, sink in net["users"]
            if self.own(cell) and sink and _routed_to(net["wires"], sink) not in net["wires"]
        ]

    def _needed(self, net: Mapping[str, Any]) -> set[Pip]:
        if last(net["driver"]).startswith(HARNESS):
            return set()
        wires = net["wires"]
        return {pip for cell, _, sink in net["users"] if self.own(cell) for pip in _way(wires, _routed_to(wires, sink))}


def read_routed(path: Path, inputs: frozenset[str]) -> Routed:
    """Read a dump. Raises OSError, ValueError."""
    found = json.loads(path.read_text(encoding="utf-8"))
    return Routed({name: (kind, place) for name, (kind, place) in found["cells"].items()}, found["nets"], inputs)


def feature_of(database: Database, pip: str) -> Feature | None:
    """The feature of a pip by nextpnr's name; None for pips inside sites, which have none of that form."""
    place, _, rest = pip.partition("/")
    destination, _, source = rest.partition("/")
    tile = tile_of(database, place)
    if tile is None or "." in destination or "." in source:
        return None
    return Feature(tile, f"{destination}.{source.partition('/')[0]}")


def tile_of(database: Database, place: str) -> str | None:
    """The tile at ``X85Y13``."""
    x, _, y = place[1:].partition("Y")
    found = database.tile_at.get((int(x), int(y)))
    return found.name if found else None


def _routed_to(wires: Mapping[str, Any], sink: str) -> str:
    """The wire at which the route to a look-up table's input ends: the router may swap inputs, and then the cell's
    pins are renamed after the slice's, but the wires are not."""
    table = _TABLE_PIN.fullmatch(sink)
    if table is None:
        return sink
    site, letter, number = table.groups()
    ends = (f"{site}.{letter}{pin}" for pin in range(1, 7))
    return next((end for end in ends if (wires.get(end) or ("", ""))[1].endswith(f"_{letter}{number}")), sink)


def _way(wires: Mapping[str, Any], sink: str) -> Iterator[Pip]:
    while (way := wires.get(sink)) is not None:
        yield way[0], sink
        sink = way[1]


def last(name: str) -> str:
    """The own name of a cell, without the hierarchy above it."""
    return name.rpartition(".")[2]
