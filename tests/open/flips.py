# SPDX-License-Identifier: Apache-2.0
"""Single bits of a configured module flipped: what its bits do then, and what they should do."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from expected import Change, Design, run
from routed import Routed

from cm.bits import Simulation, extract
from cm.xray import Feature, Wires, bits_of, decode

_STORED = re.compile(r"(SLICE[LM]_X\d)\.(([A-D]5?FF)\.(ZINI|ZRST)|FFSYNC)")
_TABLE = re.compile(r"(SLICE[LM]_X\d)\.([A-D])LUT\.INIT\[\d+\]")


@dataclass(frozen=True)
class Flip:
    """A bit, and what flipping it changes by the routed design."""

    kind: str
    name: str
    bit: tuple[int, int]  # frame address, position
    change: Change


class Flips:
    """All single-bit flips of a routed module that the routed design can tell the effect of."""

    def __init__(self, routed: Routed, seed: int) -> None:
        self.routed, self.design = routed, Design(routed.netlist, routed.routes)
        self._wires, self._random = Wires(routed.database), random.Random(seed)
        self.values = [self._random.getrandbits(8) & 0x7F for _ in range(120)]

    def draw(self) -> Iterator[Flip]:
        """For ever: contents of tables, modes of registers, pips, in turn."""
        tables, stored, pips = self._sorted(self._tables), self._sorted(self._modes), self._sorted(self._pips)
        while True:
            for source, make in ((tables, self._table), (stored, self._mode), (pips, self._pip)):
                flip = None
                while flip is None:
                    flip = make(self._random.choice(source))
                yield flip

    def found(self, flip: Flip) -> list[int]:
        """What the flipped bits do."""
        frames = dict(self.routed.frames)
        frames[flip.bit[0]] = frames.get(flip.bit[0], 0) ^ 1 << flip.bit[1]
        features = decode(self.routed.database, frames).features
        simulation = Simulation(extract(self.routed.database, self._wires, features, self.routed.boundary))
        seen = []
        for value in self.values:
            simulation.set({f"a[{bit}]": bool(value >> bit & 1) for bit in range(8)})
            simulation.clock()
            seen.append(sum(simulation.output(f"y[{bit}]") << bit for bit in range(8)))
        return seen

    def wanted(self, flip: Flip, folder: Path) -> list[int]:
        """What they should do; -1 where the models of the cells do not know."""
        return run(folder, self.design.verilog(flip.change), self.values)

    def _sorted(self, wanted: object) -> list[Feature]:
        assert callable(wanted)
        return sorted(feature for feature in self.routed.features if wanted(feature))

    def _tables(self, feature: Feature) -> bool:
        match = _TABLE.fullmatch(feature.name)
        written = {f"{match[1]}.{match[2]}LUT.{kind}" for kind in ("RAM", "SRL")} if match else set()
        return match is not None and written.isdisjoint(self._names(feature.tile))

    def _names(self, tile: str) -> set[str]:
        return {feature.name for feature in self.routed.features if feature.tile == tile}

    def _modes(self, feature: Feature) -> bool:
        return _STORED.fullmatch(feature.name) is not None

    def _pips(self, feature: Feature) -> bool:
        named = feature.tile.startswith("INT_") and feature.name.count(".") == 1
        return named and bool(bits_of(self.routed.database, feature))

    def _place(self, feature: Feature, site: str) -> tuple[str, str]:
        tile = self.routed.database.tiles[feature.tile]
        return f"X{tile.x}Y{tile.y}", f"SLICE_X{site[-1]}Y0"

    def _bit(self, feature: Feature) -> tuple[int, int]:
        bits = bits_of(self.routed.database, feature)
        assert bits
        return self._random.choice([place for place, value in bits if value])

    def _table(self, near: Feature) -> Flip | None:
        """Any bit of a table that holds something; half of those that no cell reads are left out."""
        match = _TABLE.fullmatch(near.name)
        assert match is not None
        bit = self._random.randrange(64)
        feature = Feature(near.tile, f"{match[1]}.{match[2]}LUT.INIT[{bit}]")
        change = self.design.table_bit(*self._place(near, match[1]), match[2], bit)
        if not change.cells and self._random.random() < 0.5:
            return None
        return Flip("table", str(feature), self._bit(feature), change)

    def _mode(self, near: Feature) -> Flip | None:
        match = _STORED.fullmatch(near.name)
        assert match is not None
        tile, site = self._place(near, match[1])
        change = self.design.storage(tile, site, match[3] or "", match[4] or "FFSYNC")
        return Flip("mode", str(near), self._bit(near), change) if change.cells else None

    def _pip(self, near: Feature) -> Flip | None:
        tile = self.routed.database.tiles[near.tile]
        target, source = near.name.split(".")
        change = self.design.cut(f"X{tile.x}Y{tile.y}/{target}/{source}")
        if change is None or any("begins" in cell or "ends" in cell for cell, _ in change.cut):
            return None
        return Flip("pip", str(near), self._bit(near), change)
