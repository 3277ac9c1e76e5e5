# SPDX-License-Identifier: Apache-2.0
"""Where a wire's value comes from: back through the pips that are on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from cm.formats.xray import Database, Feature, Pip, SitePins, Wires
from cm.simulation.bits.blocks import HALVES

_SPINE = "HCLK_CK_BUFHCLK"  # wires of a row of clock regions, by number
_CONSTANTS = {"VCC_WIRE": True, "GND_WIRE": False}


class SitePin(NamedTuple):
    """An output of a site: where a value is made.

    `site`: as features name it (``SLICEL_X0``, ``RAMB18_Y0`` for the lower half of a block RAM, ``DSP_1`` for the upper
    DSP48E1 of a tile).
    """

    tile: str
    site: str
    pin: str


class ClockLine(NamedTuple):
    """One of the twelve lines that bring clocks to a row of clock regions."""

    number: int


class Constant(NamedTuple):
    """The constant wires of an interconnect tile."""

    value: bool


class _Switch(NamedTuple):
    """A pip, and when it is on even without its feature.

    Either always, or, for one without bits that are 1, while no other pip of its wire is on.
    """

    pip: Pip
    feature: str
    always: bool
    resting: bool


Source = SitePin | ClockLine | Constant


class Routing:
    """The pips that features switch on. Answers are cached."""

    def __init__(self, database: Database, wires: Wires, features: Iterable[Feature]) -> None:
        self._database, self._wires = database, wires
        self._on: dict[str, set[str]] = {}
        for feature in features:
            self._on.setdefault(feature.tile, set()).add(feature.name)
        self._into: dict[str, Mapping[str, list[_Switch]]] = {}
        self._made: dict[str, Mapping[str, tuple[SitePins, str]]] = {}

    def features(self, tile: str) -> set[str]:
        """What is on in a tile."""
        return self._on.get(tile, set())

    def sources(self, tile: str, wire: str) -> tuple[Source, ...]:
        """All drivers of a wire: none if it is unconnected, several if the configuration makes them fight."""
        found: dict[Source, None] = {}
        seen = set()
        todo = [(tile, wire)]
        while todo:
            node = self._wires.node(*todo.pop())
            if node in seen:
                continue
            seen.add(node)
            for here, name in node:
                end = self._end(here, name)
                if end is not None:
                    found[end] = None
                    break
            else:
                todo += [(here, pip.source) for here, name in node for pip in self._driving(here, name)]
        return tuple(found)

    def _end(self, tile: str, wire: str) -> Source | None:
        if wire in _CONSTANTS:
            return Constant(_CONSTANTS[wire])
        if wire.startswith(_SPINE) and tile.startswith("HCLK"):
            return ClockLine(int(wire.removeprefix(_SPINE)))
        if wire.startswith("BRAM_") and not wire.startswith("BRAM_LOGIC_OUTS"):
            prefix = next((one for one in HALVES if wire.startswith(f"{one}DO")), None)
            if prefix is not None:
                return SitePin(tile, f"RAMB18_Y{HALVES[prefix]}", wire.removeprefix(prefix))
            if wire.startswith("BRAM_FIFO36_") and not any(one.startswith("RAMB36") for one in self.features(tile)):
                return None  # the same outputs as of a whole block, which this is not
        made = self._outputs(self._database.tiles[tile].kind).get(wire)
        if made is None:
            return None
        site, pin = made
        if site.type == "TIEOFF":
            return Constant(pin == "HARD1")
        return SitePin(tile, f"DSP_{site.y}" if site.type == "DSP48E1" else f"{site.type}_X{site.x}", pin)

    def _driving(self, tile: str, wire: str) -> Iterator[Pip]:
        into = self._pips(self._database.tiles[tile].kind).get(wire, ())
        on = self.features(tile)
        chosen = [one.pip for one in into if one.always or one.feature in on]
        yield from chosen or (one.pip for one in into if one.resting)

    def _pips(self, kind: str) -> Mapping[str, list[_Switch]]:
        if kind not in self._into:
            found: dict[str, list[_Switch]] = {}
            for pip in self._wires.kind(kind).pips.values():
                if not pip.pseudo:
                    found.setdefault(pip.destination, []).append(self._switch(kind, pip))
                if pip.both_ways:  # long wires: listed once, with a feature for each direction
                    back = pip._replace(source=pip.destination, destination=pip.source)
                    found.setdefault(back.destination, []).append(self._switch(kind, back))
            self._into[kind] = found
        return self._into[kind]

    def _switch(self, kind: str, pip: Pip) -> _Switch:
        feature = pip.feature
        free = self._database.ppips(kind).get(feature)
        bits = self._database.segbits(kind).features.get(feature, ())
        zeros = bool(bits) and not any(bit.value for bit in bits)
        return _Switch(pip, feature, free == "always", free == "default" or zeros)

    def _outputs(self, kind: str) -> Mapping[str, tuple[SitePins, str]]:
        """Output pins by wire: of slices, and of other sites that make signals."""
        if kind not in self._made:
            drives = _drives(self._wires, kind)
            self._made[kind] = {
                wire: (site, pin)
                for site in self._wires.kind(kind).sites
                for pin, wire in site.pins.items()
                if not site.type.startswith("SLICE") or pin in SLICE_OUTPUTS
                if site.type.startswith("SLICE") or wire in drives
            }
        return self._made[kind]


SLICE_OUTPUTS = frozenset(f"{letter}{kind}" for letter in "ABCD" for kind in ("", "MUX", "Q")) | {"COUT"}


def _drives(wires: Wires, kind: str) -> set[str]:
    """The wires of a kind of tile that real pips lead away from, none to: outputs, where they are pins of a site."""
    pips = [pip for pip in wires.kind(kind).pips.values() if not pip.pseudo]
    return {pip.source for pip in pips} - {pip.destination for pip in pips}
