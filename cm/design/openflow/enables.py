# SPDX-License-Identifier: Apache-2.0
"""Look-up tables that are written, kept apart: all in a slice share one write enable.

nextpnr 0.11 places shift registers and memories without a look at their enables, and its router ends with "attempting
to reserve sink input path wire '….WEMUX_OUT'" where two meet. Each write enable of shift registers, and all memories
together, get slices of their own here; no two memories are ever placed in one slice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cm.design.errors import BuildError
from cm.formats.xray import Tile

Cell = dict[str, Any]
_TABLES = 4  # of a slice
_SHIFTS, _MEMORIES, _DUAL = "SRL", ("RAM32", "RAM64", "RAM128", "RAM256"), ("RAM32X1D", "RAM64X1D")
_MEMORY = "memory"


@dataclass(frozen=True, slots=True)
class Shares:
    """Areas of slices by name, as nextpnr names those, and the cells (their names in the netlist) confined to each."""

    areas: dict[str, list[str]] = field(default_factory=dict)
    cells: dict[str, str] = field(default_factory=dict)


def shares(cells: Mapping[str, Cell], tiles: Iterable[Tile], what: str) -> Shares:
    """Divide the slices of `tiles` that can be memory. Raises BuildError where there are too few for `what`."""
    groups = _groups(cells)
    if len(groups) < 2:
        return Shares()
    places = [f"X{tile.x}Y{tile.y}/SLICE_X0Y0" for tile in tiles if tile.kind.startswith("CLBLM")]
    need = {name: _slices(name, [cells[one] for one in members]) for name, members in groups.items()}
    if sum(need.values()) > len(places):
        raise BuildError(
            f"{what}: its shift registers and memories in look-up tables take {sum(need.values())} slices, because "
            f"those with different write enables cannot share one, and where it is placed {len(places)} can be "
            f"memory (SLICEM): let more of them have the same enable, put memories into block RAM, or give the "
            f"region more columns with SLICEM"
        )
    areas: dict[str, list[str]] = {name: [] for name in groups}
    for place, name in zip(places, _in_turn(need, len(places)), strict=True):
        areas[name].append(place)
    return Shares(areas, {one: name for name, members in groups.items() for one in members})


def _groups(cells: Mapping[str, Cell]) -> dict[str, list[str]]:
    """The names of cells that may share slices, by a name for them."""
    enables: dict[Hashable, list[str]] = {}
    memories = []
    for name, cell in sorted(cells.items()):
        if cell["type"].startswith(_SHIFTS):
            pins = cell["connections"]
            enables.setdefault((*pins["CE"], *pins["CLK"]), []).append(name)
        elif cell["type"].startswith(_MEMORIES):
            memories.append(name)
    found = {f"shift_{number}": members for number, members in enumerate(enables.values())}
    return found | ({_MEMORY: memories} if memories else {})


def _slices(name: str, cells: Sequence[Cell]) -> int:
    """How many a group takes: nextpnr joins memories with two ports where they are written alike."""
    if name != _MEMORY:
        return -(-len(cells) // _TABLES)
    dual = [cell for cell in cells if cell["type"] in _DUAL]
    written: Counter[tuple[int, Hashable]] = Counter()
    for cell in dual:
        pins = cell["connections"]
        control = tuple(pins[pin][0] for pin in sorted(pins) if pin in ("WE", "WCLK") or pin[0] == "A")
        written[2 if pins.get("SPO") else 3, (cell["type"], control)] += 1  # so many in a slice
    return len(cells) - len(dual) + sum(-(-number // in_slice) for (in_slice, _), number in written.items())


def _in_turn(need: Mapping[str, int], places: int) -> Iterator[str]:
    """Who gets which of so many places: each as much as it needs of the whole, spread evenly."""
    whole = sum(need.values())
    owed = dict.fromkeys(need, 0)
    for _ in range(places):
        for name, number in need.items():
            owed[name] += number
        most = max(owed, key=owed.__getitem__)
        owed[most] -= whole
        yield most
