# SPDX-License-Identifier: Apache-2.0
"""Single bits of a configured module flipped: what its bits do then, and what they should do."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import cycle
from pathlib import Path

import changes
from changes import LETTERS, Change
from design import Cell, Design
from expected import circular, outputs, simulated
from routed import Routed, as_verilog

from cm.formats.xray import Feature, Tile, Wires, bits_of, decode, tiles_with_bits
from cm.simulation.bits import extract

BATCH = 25  # designs in one run of Icarus
TURNS = [
    *("table", "register", "pip", "control", "join", "table", "pip", "memory"),
    *("register", "pip", "control", "join", "carry", "pip", "table", "multiplexer"),
]
_CONTROLS = ("FFSYNC", "LATCH", "CLKINV", "CEUSEDMUX", "SRUSEDMUX")


@dataclass(frozen=True)
class Flip:
    """A bit, and what flipping it changes by the routed design."""

    kind: str
    name: str
    bit: tuple[int, int]  # frame address, position
    change: Change


class Flips:
    """Single-bit flips of a routed module that the routed design can tell the effect of."""

    def __init__(self, routed: Routed, seed: int) -> None:
        self.routed, self.design = routed, Design(routed.netlist, routed.routes)
        self._wires, self._random = Wires(routed.database), random.Random(seed)
        self.values = [self._random.getrandbits(8) & 0x7F for _ in range(120)]
        self._base = decode(routed.database, routed.frames).features
        self._cells = sorted((cell for cell in self.design.cells.values() if not cell.outside), key=lambda c: c.name)

    def draw(self) -> Iterator[Flip]:
        """For ever, one kind after the other."""
        makers: dict[str, Callable[[], Flip | None]] = {
            "table": self._table, "register": self._register, "control": self._control, "memory": self._memory,
            "carry": self._carry, "multiplexer": self._multiplexer, "pip": self._pip, "join": self._join,
        }  # fmt: skip
        for kind in cycle(TURNS):
            flip = None
            while flip is None:
                flip = makers[kind]()
            yield flip

    def found(self, flips: Sequence[Flip], folder: Path) -> list[list[int]]:
        """What the flipped bits do."""
        found = []
        for first in range(0, len(flips), BATCH):
            some = flips[first : first + BATCH]
            features = map(self.features, some)
            modules = [
                as_verilog(extract(self.routed.database, self._wires, one, self.routed.boundary)) for one in features
            ]
            found += simulated(folder, modules, [circular(self.design, flip.change) for flip in some], self.values)
        return found

    def features(self, flip: Flip) -> set[Feature]:
        """What the frames say with the bit flipped: the tiles that it belongs to are read anew."""
        address, position = flip.bit
        frames = dict(self.routed.frames)
        frames[address] = frames.get(address, 0) ^ 1 << position
        near = {
            tile.name
            for tile in tiles_with_bits(self.routed.database, [address])
            if any(0 <= position - 32 * one.offset < 32 * one.words for one in tile.segments)
        }
        return {feature for feature in self._base if feature.tile not in near} | decode(
            self.routed.database, frames, near
        ).features

    def wanted(self, flips: Sequence[Flip], folder: Path) -> list[list[int]]:
        """What they should do; -1 where the models of the cells do not know."""
        found = []
        for first in range(0, len(flips), BATCH):
            some = [flip.change for flip in flips[first : first + BATCH]]
            found += outputs(folder, self.design, some, self.values)
        return found

    def sound(self, folder: Path) -> list[int]:
        """What the module does with no bit flipped."""
        return outputs(folder, self.design, [Change()], self.values)[0]

    def _flip(self, kind: str, place: Cell, name: str, change: Change | None) -> Flip | None:
        """The bit of a feature of a site that one bit switches."""
        if change is None:
            return None
        tile, site = self._site(place)
        feature = Feature(tile.name, f"{site}.{name}")
        bits = [where for where, value in bits_of(self.routed.database, feature) or () if value]
        assert len(bits) == 1, feature
        return Flip(kind, str(feature), bits[0], change)

    def _site(self, cell: Cell) -> tuple[Tile, str]:
        x, _, y = cell.tile[1:].partition("Y")
        tile, number = self.routed.database.tile_at[int(x), int(y)], int(cell.site[7])
        sites = sorted(tile.sites, key=lambda name: int(name.partition("_X")[2].partition("Y")[0]))
        return tile, f"{tile.sites[sites[number]]}_X{number}"

    def _any(self, *kinds: str) -> Cell:
        return self._random.choice([cell for cell in self._cells if cell.kind.startswith(kinds)])

    def _on(self, cell: Cell, name: str) -> bool:
        tile, site = self._site(cell)
        return Feature(tile.name, f"{site}.{name}") in self.routed.features

    def _table(self) -> Flip | None:
        """Any bit of a table that holds something; half of those that no cell reads are left out."""
        cell, bit = self._any("LUT"), self._random.randrange(64)
        change = changes.table_bit(self.design, cell.tile, cell.site, cell.element[0], bit)
        if not change and self._random.random() < 0.5:
            return None
        return self._flip("table", cell, f"{cell.element[0]}LUT.INIT[{bit}]", change)

    def _register(self) -> Flip | None:
        cell, what = self._any("FD"), self._random.choice(("ZINI", "ZRST"))
        change = changes.register(self.design, cell.tile, cell.site, cell.element, what)
        return self._flip(f"register {what}", cell, f"{cell.element}.{what}", change)

    def _control(self) -> Flip | None:
        cell, what = self._any("FD"), self._random.choice(_CONTROLS)
        change = changes.control(self.design, cell.tile, cell.site, what)
        if what == "LATCH" and change and circular(self.design, change):
            return None  # while it is open it goes round as often as its delays let it
        return self._flip(f"control {what}", cell, what, change)

    def _memory(self) -> Flip | None:
        cell = self._any("RAMD32", "SRL")
        letter, what = cell.element[0], self._random.choice(("INIT", "INIT", "mode", "WEMUX", "DI1MUX"))
        if what == "INIT":
            bit = self._random.randrange(64)
            change = changes.memory_bit(self.design, cell.tile, cell.site, letter, bit)
            return self._flip("memory INIT", cell, f"{letter}LUT.INIT[{bit}]", change)
        if what == "DI1MUX" and not self._on(cell, f"{letter}LUT.DI1MUX.{letter}I"):
            return None
        mode = cell.kind[:3]
        name = {"mode": f"{letter}LUT.{mode}", "WEMUX": "WEMUX.CE", "DI1MUX": f"{letter}LUT.DI1MUX.{letter}I"}[what]
        what = mode if what == "mode" else what
        change = changes.written(self.design, cell.tile, cell.site, "" if what == "WEMUX" else letter, what)
        return self._flip(f"memory {what}", cell, name, change)

    def _carry(self) -> Flip | None:
        cell = self._any("CARRY4")
        names = ["PRECYINIT.AX", "PRECYINIT.CIN", *(f"CARRY4.{letter}CY0" for letter in LETTERS)]
        name = self._random.choice([name for name in names if self._on(cell, name)])
        what = name.removeprefix("CARRY4.")
        return self._flip("carry", cell, name, changes.carry(self.design, cell.tile, cell.site, what))

    def _multiplexer(self) -> Flip | None:
        """A bit that makes of one setting of FFMUX or OUTMUX another one."""
        cell, letter, mux = self._any("FD", "LUT"), self._random.choice(LETTERS), self._random.choice(("FF", "OUT"))
        tile, site = self._site(cell)
        start = f"{site}.{letter}{mux}MUX."
        settings = {
            name.removeprefix(start): dict(bits_of(self.routed.database, Feature(tile.name, name)) or ())
            for name in self.routed.database.segbits(tile.kind).features
            if name.startswith(start)
        }
        now = [source for source in settings if self._on(cell, f"{letter}{mux}MUX.{source}")]
        if not now:
            return None
        source = self._random.choice(sorted(set(settings) - set(now)))
        before, after = settings[now[0]], settings[source]
        different = [bit for bit, value in after.items() if before.get(bit) != value]
        change = changes.chosen(self.design, cell.tile, cell.site, letter, f"{mux}MUX", source)
        if len(different) != 1 or before.keys() != after.keys() or change is None:
            return None
        return Flip("multiplexer", f"{tile.name}.{start}{now[0]} to {source}", different[0], change)

    @cached_property
    def _pips(self) -> list[tuple[Feature, str]]:
        """Pips of interconnect tiles that bits switch, with nextpnr's names."""
        found = []
        for feature in sorted(self.routed.features):
            tile = self.routed.database.tiles[feature.tile]
            named = feature.tile.startswith("INT_") and feature.name.count(".") == 1
            if named and bits_of(self.routed.database, feature):
                found.append((feature, f"X{tile.x}Y{tile.y}/{feature.name.replace('.', '/')}"))
        return found

    def _pip(self) -> Flip | None:
        """Any of the bits that a pip wants to be 1."""
        feature, pip = self._random.choice(self._pips)
        change = changes.cut(self.design, pip)
        if change is None or any(self.design.cells[cell].outside for cell, _ in change.pins):
            return None
        bits = [place for place, value in bits_of(self.routed.database, feature) or () if value]
        return Flip("pip", str(feature), self._random.choice(bits), change)

    def _join(self) -> Flip | None:
        """A bit that switches a second pip on, beside one into the same wire."""
        feature, pip = self._random.choice(self._pips)
        others = sorted(self.design.beside(pip))
        if not others:
            return None
        other = self._random.choice(others)
        second = Feature(feature.tile, other.partition("/")[2].replace("/", "."))
        own, its = (dict(bits_of(self.routed.database, one) or ()) for one in (feature, second))
        missing = [place for place, value in its.items() if value and not own.get(place, False)]
        against = any(own.get(place) for place, value in its.items() if not value)
        against |= any(place in own for place in missing)
        change = changes.joined(self.design, pip, other)
        if len(missing) != 1 or against or not change or any(self.design.cells[c].outside for c, _ in change.pins):
            return None
        return Flip("join", f"{feature} and {second.name}", missing[0], change)
