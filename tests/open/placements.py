# SPDX-License-Identifier: Apache-2.0
"""Random designs for the open flow: places and sizes of regions that are legal, and modules for them."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from synthetic import Ports, draw_module

from cm.design.boards import boards
from cm.design.openflow.tools import fetched
from cm.formats.xray import Database

ROWS_OF_SLICES, ROWS_OF_BLOCKS = 50, 20  # in a clock region: SLICE; RAMB18 and DSP48
BOARDS = {"xc7z010": "zybo-z7-10", "xc7z020": "zybo-z7-20"}
WIRES = 200  # of a boundary: what a column of one clock region has anchors for, of which registers take 140
_KINDS = {"CLBLL": "L", "CLBLM": "M", "BRAM": "B", "DSP": "D"}


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a row of clock regions: what it has ('L', 'M' slices, 'B' block RAM, 'D' DSP48), numbers of sites."""

    kind: str
    first: int
    last: int
    row: int  # of clock regions, from below

    def ranges(self) -> Iterator[str]:
        """As a pblock names it."""
        if self.kind in "LM":
            low = self.row * ROWS_OF_SLICES
            yield f"SLICE_X{self.first}Y{low}:SLICE_X{self.last}Y{low + ROWS_OF_SLICES - 1}"
            return
        low, count = self.row * ROWS_OF_BLOCKS, ROWS_OF_BLOCKS
        if self.kind == "D":
            yield f"DSP48_X{self.first}Y{low}:DSP48_X{self.last}Y{low + count - 1}"
            return
        yield f"RAMB18_X{self.first}Y{low}:RAMB18_X{self.last}Y{low + count - 1}"
        yield f"RAMB36_X{self.first}Y{low // 2}:RAMB36_X{self.last}Y{(low + count) // 2 - 1}"


@dataclass(frozen=True, slots=True)
class Placement:
    """A drawn design: what `seed` it came of, its schema, its sources by name."""

    seed: int
    device: str
    schema: dict[str, Any]
    sources: dict[str, str]

    def write(self, folder: Path) -> None:
        """As a user's folder."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "build.yaml").write_text(yaml.safe_dump(self.schema, sort_keys=False))
        for name, text in self.sources.items():
            (folder / name).write_text(text)

    def __str__(self) -> str:
        regions = self.schema["regions"].items()
        return f"seed {self.seed}, {self.device}: " + "; ".join(f"{name} {one['pblock']}" for name, one in regions)


@cache
def columns(device: str) -> tuple[Column, ...]:
    """Of all rows of clock regions, from the left in each."""
    tree = fetched()
    assert tree is not None
    part = boards()[BOARDS[device]].part
    database = Database.open(part, tree.path("usr/share/prjxray/database"))
    found = {}
    for tile in database.tiles.values():
        kind = next((letter for start, letter in _KINDS.items() if tile.kind.startswith(start)), None)
        names = [name for name in tile.sites if name.startswith(("SLICE", "RAMB18", "DSP48"))]
        if kind is None or not names:
            continue
        places = [tuple(map(int, name.rpartition("_X")[2].split("Y"))) for name in names]
        xs, ys = zip(*places, strict=True)
        row = ys[0] // (ROWS_OF_SLICES if kind in "LM" else ROWS_OF_BLOCKS)
        found[row, tile.x] = Column(kind, min(xs), max(xs), row)
    return tuple(found[key] for key in sorted(found))


def draw(seed: int, device: str = "xc7z010") -> Placement:
    """A design of one or two regions with two modules each."""
    source = random.Random(f"{device} {seed}")
    free = list(columns(device))
    regions: dict[str, Any] = {}
    modules: dict[str, Any] = {}
    sources: dict[str, str] = {}
    for name in ("left", "right")[: 1 + (source.random() < 0.35)]:
        chosen = _columns_of_a_region(source, free)
        free = [column for column in free if column not in chosen]
        has = "".join({column.kind for column in chosen if column is not chosen[0]})
        ports = Ports(source.choice((8, 8, 16)), source.choice((8, 8, 16)))
        pblock = [text for column in chosen for text in column.ranges()]
        source.shuffle(pblock)
        regions[name] = {
            "pblock": pblock,
            "clock": "fclk0",
            "loader": "fpga_manager",
            "interfaces": _interfaces(source, name, ports),
        }
        room = sum(column.kind in "LM" for column in chosen) - 1
        for number in range(2):
            module = f"{name}_{number}"
            sources[f"{module}.v"] = draw_module(source, module, ports, has, source.randint(3, 4 + 4 * room))
            modules[module] = {
                "regions": [name],
                "sources": [f"{module}.v"],
                "resources": {"lut": 20, "ff": 20},
                "registers": {f"word_{module}": {"offset": 0, "access": "ro", "volatile": True}},
            }
    schema = {
        "project": {"name": f"drawn_{seed}", "board": BOARDS[device]},
        "clocks": {"fclk0": {"rate": source.choice((25_000_000, 40_000_000, 50_000_000))}},
        "regions": regions,
        "modules": modules,
    }
    return Placement(seed, device, schema, sources)


def _interfaces(source: random.Random, region: str, ports: Ports) -> dict[str, Any]:
    """Streams from and to memory, by an engine each or one of both; or one of them left open."""
    shape = {"shape": [48, 64]}
    into = {"stream": f"to_{region}", **shape}
    out = {"stream": f"from_{region}", **shape}
    kind = source.choice(("own", "shared", "one way", "registers only", "registers only"))
    if kind == "shared" and ports.into == ports.out:
        return {"s_axis": {**into, "engine": region}, "m_axis": {**out, "engine": region}}
    if kind == "own":
        return {"s_axis": into, "m_axis": out}
    if kind == "registers only":
        return {"s_axis": {"connect": "none"}, "m_axis": {"connect": "none"}}
    return {"s_axis": into, "m_axis": {"connect": "none"}}


def _columns_of_a_region(source: random.Random, free: Sequence[Column]) -> list[Column]:
    """Neighbours of one row, or of two or three above each other; some leave out a column within."""
    while True:
        row = source.choice([column.row for column in free])
        beside = [column for column in free if column.row == row]
        slices = source.choice((3, 3, 4, 5, 6, 8))
        begin = source.choice((0, None, None, None, None))
        at = source.randrange(len(beside)) if begin is None else begin
        if source.random() < 0.15:  # at the right edge
            at = max(0, len(beside) - slices - 1)
        chosen: list[Column] = []
        for column in beside[at:]:
            if sum(one.kind in "LM" for one in chosen) == slices:
                break
            if column.kind in "LM" or (chosen and source.random() < 0.8):
                chosen.append(column)
        if source.random() < 0.15:  # as far up as there are the same columns
            places = {(one.kind, one.first) for one in chosen}
            above = [one for one in free if one.row == row + 1 and (one.kind, one.first) in places]
            if len(above) == len(places):
                chosen += above
        if sum(one.kind in "LM" and one.row == row for one in chosen) >= 3:
            return chosen
