# SPDX-License-Identifier: Apache-2.0
"""Cells of yosys' JSON rewritten into what nextpnr 0.11 can place: shift registers, distributed RAM, write enables.

Shift registers: a look-up table is inserted between an anchor and a flip-flop that it feeds. nextpnr packs a look-up
table and the flip-flop behind it into one cluster, and crashes in `dict::at()` if the look-up table has a fixed place.

Memories: nextpnr fails an assertion on RAM64X1S. It looks for the contents of RAM32M and RAM64M under INITA, which
UNISIM calls INIT_A, so that they are initialised with zeros; given as INITA, those of a RAM32M fail an assertion.
Therefore RAM64X1S with the same address become a RAM64M, and a RAM32M with other contents than zeros two of them.

Enables: all look-up tables of a slice that are written share one write enable. nextpnr places them without a look at
that, and its router ends with "attempting to reserve sink input path wire '….WEMUX_OUT'" where two meet. Each write
enable of shift registers, and all memories together, get slices of their own here; no two memories are ever placed in
one slice.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from cm.design.errors import BuildError
from cm.design.openflow.layout import site_kind
from cm.design.openflow.netlists import ANCHOR
from cm.design.openflow.routed import tile_of
from cm.formats.xray import Database, Feature, Tile

_PASS = "cm_pass_"


def separate(netlist: dict[str, Any], top: str) -> int:
    """Change yosys' netlist in place; return how many look-up tables were added."""
    module = netlist["modules"][top]
    cells, names = module["cells"], module["netnames"]
    sources = {
        cell["connections"]["O"][0]
        for name, cell in cells.items()
        if name.rpartition(".")[2].startswith(ANCHOR) and cell["type"] == "LUT1"
    }
    fed = [cell for cell in cells.values() if cell["type"].startswith("FD") and cell["connections"]["D"][0] in sources]
    bit = 1 + max((wire for entry in names.values() for wire in entry["bits"] if isinstance(wire, int)), default=1)
    for number, cell in enumerate(fed):
        source = cell["connections"]["D"][0]
        cells[f"{_PASS}{number}"] = _pass_on(source, bit + number)
        names[f"{_PASS}net_{number}"] = {"hide_name": 1, "bits": [bit + number], "attributes": {}}
        cell["connections"]["D"] = [bit + number]
    return len(fed)


def _pass_on(source: object, target: int) -> dict[str, Any]:
    return {
        "hide_name": 1,
        "type": "LUT1",
        "parameters": {"INIT": "10"},
        "attributes": {"keep": "00000000000000000000000000000001"},
        "port_directions": {"I0": "input", "O": "output"},
        "connections": {"I0": [source], "O": [target]},
    }


Cell = dict[str, Any]
_TABLE = re.compile(r"SLICE_X(\d)Y0\.([A-D])([56])LUT")
_LAST = {"SRLC32E": "Q31", "SRLC16E": "Q15"}


def unchain(netlist: dict[str, Any], top: str) -> int:
    """Change yosys' netlist in place so that long shift registers do not use the cascade to the next look-up table.

    nextpnr has no wire for that output (Q31, Q15) and stops with an error. A second look-up table with the same
    input, always read at its last bit, gives the same signal. Returns how many were added.
    """
    cells = netlist["modules"][top]["cells"]
    used = {wire for cell in cells.values() for wire in wires_of(cell, "input")}
    used |= {wire for port in netlist["modules"][top]["ports"].values() for wire in port["bits"]}
    long = {
        name: cell
        for name, cell in cells.items()
        if cell["type"] in _LAST and used.intersection(cell["connections"].get(_LAST[cell["type"]], ()))
    }
    for name, cell in long.items():
        cells[f"{name}_cm_end"] = _read_at_its_end(cell)
    for cell in cells.values():
        if cell["type"] in _LAST:
            cell["connections"].pop(_LAST[cell["type"]], None)
            cell["port_directions"].pop(_LAST[cell["type"]], None)
    return len(long)


def _read_at_its_end(cell: Cell) -> Cell:
    connections = dict(cell["connections"])
    connections["Q"] = connections.pop(_LAST[cell["type"]])
    for pin, wires in connections.items():
        if pin in ("A", "A0", "A1", "A2", "A3"):
            connections[pin] = ["1"] * len(wires)
    directions = {pin: way for pin, way in cell["port_directions"].items() if pin in connections}
    return {**cell, "connections": connections, "port_directions": directions}


def wires_of(cell: Cell, way: str) -> Iterator[object]:
    """The wires at a cell's pins of one direction."""
    for pin, wires in cell["connections"].items():
        if cell["port_directions"].get(pin) == way:
            yield from wires


def with_contents(
    features: Iterable[Feature], database: Database, netlist: Mapping[str, Any], places: Mapping[str, tuple[str, str]]
) -> frozenset[Feature]:
    """Correct the initial contents of shift registers in nextpnr's features.

    nextpnr writes INIT like that of a look-up table. In the slice each bit occurs twice, the newest lowest (UG474;
    Vivado's bitstreams agree, openXC7/nextpnr-xilinx issue 181); 16 bits are half a table.
    """
    kept = frozenset(features)
    for name, cell in netlist.items():
        if not cell["type"].startswith("SRL") or name not in places:
            continue
        place, _, rest = places[name][1].partition("/")
        found, tile = _TABLE.fullmatch(rest), tile_of(database, place)
        if found is None or tile is None:
            raise BuildError(f"{name} is at {places[name][1]}, which is not a look-up table")
        table = f"{site_kind(database.tiles[tile], int(found[1]))}_X{found[1]}.{found[2]}LUT.INIT"
        kept = _written(kept, tile, table, cell, 32 if cell["type"] == "SRL16E" and found[3] == "6" else 0)
    return kept


def _written(features: frozenset[Feature], tile: str, table: str, cell: Cell, low: int) -> frozenset[Feature]:
    bits = cell["parameters"].get("INIT", "")[::-1]
    length = 16 if cell["type"] == "SRL16E" else 32
    own = {Feature(tile, f"{table}[{at}]") for at in range(low, low + 2 * length)}
    ones = {at for at in range(2 * length) if bits[at // 2 : at // 2 + 1] == "1"}
    return (features - own) | {Feature(tile, f"{table}[{low + at}]") for at in ones}


_LETTERS = "ABCD"


class _Bit(NamedTuple):
    """A memory column of one bit: read address, written bit, read bit, contents."""

    address: list[object]
    data: list[object]
    output: list[object] | None
    contents: str


def packable(netlist: dict[str, Any], top: str) -> None:
    """Change yosys' netlist in place."""
    cells: dict[str, Cell] = netlist["modules"][top]["cells"]
    groups: dict[tuple[object, ...], list[str]] = {}
    for name, cell in list(cells.items()):
        if cell["type"] == "RAM64X1S":
            groups.setdefault((*_address(cell), *_control(cell)), []).append(name)
        elif cell["type"] == "RAM32M" and any("1" in contents for contents in _contents(cell)):
            for half in range(2):
                cells[f"{name}_cm_half{half}"] = _cell(cell, list(_half(cell, half)))
            del cells[name]
    for names in groups.values():
        for at in range(0, len(names), len(_LETTERS)):
            few = names[at : at + len(_LETTERS)]
            bits = [_single(cells[name]) for name in few]
            # Padding goes first: the last port has the write address of all, so it must be one that is in use
            bits = [_Bit(bits[0].address, ["0"], None, "0" * 64)] * (len(_LETTERS) - len(bits)) + bits
            cells[f"{few[0]}_cm_joined"] = _cell(cells[few[0]], bits)
            for name in few:
                del cells[name]
    for cell in cells.values():
        if cell["type"] == "RAM64M":
            _name_contents(cell)


def _address(cell: Cell) -> tuple[object, ...]:
    return tuple(cell["connections"][f"A{bit}"][0] for bit in range(6))


def _control(cell: Cell) -> tuple[object, ...]:
    pins = cell["connections"]
    return pins["WE"][0], pins["WCLK"][0], cell["parameters"].get("IS_WCLK_INVERTED", "0")


def _contents(cell: Cell) -> list[str]:
    return [cell["parameters"].get(f"INIT_{letter}", "0" * 64) for letter in _LETTERS]


def _single(cell: Cell) -> _Bit:
    pins = cell["connections"]
    return _Bit(list(_address(cell)), pins["D"], pins["O"], cell["parameters"].get("INIT", "0" * 64))


def _half(cell: Cell, number: int) -> Iterator[_Bit]:
    """One of the two columns of each letter, as the lower half of a memory that is twice as deep."""
    pins = cell["connections"]
    for letter, contents in zip(_LETTERS, _contents(cell), strict=True):
        own = "0" * 32 + "".join(contents[-1 - 2 * word - number] for word in reversed(range(32)))
        output = pins.get(f"DO{letter}")
        data = pins.get(f"DI{letter}", ["0", "0"])  # none if nothing of the letter is read
        yield _Bit([*pins[f"ADDR{letter}"], "0"], [data[number]], output and [output[number]], own)


def _cell(like: Cell, bits: Sequence[_Bit]) -> Cell:
    connections = {name: like["connections"][name] for name in ("WE", "WCLK")}
    directions = dict.fromkeys(connections, "input")
    parameters = {"IS_WCLK_INVERTED": like["parameters"].get("IS_WCLK_INVERTED", "0")}
    for letter, bit in zip(_LETTERS, bits, strict=True):
        connections |= {f"ADDR{letter}": bit.address, f"DI{letter}": bit.data}
        directions |= {f"ADDR{letter}": "input", f"DI{letter}": "input"}
        parameters[f"INIT_{letter}"] = bit.contents
        if bit.output is not None:
            connections[f"DO{letter}"], directions[f"DO{letter}"] = bit.output, "output"
    return {
        "hide_name": 1,
        "type": "RAM64M",
        "parameters": parameters,
        "attributes": like["attributes"],
        "port_directions": directions,
        "connections": connections,
    }


def _name_contents(cell: Cell) -> None:
    for letter in _LETTERS:
        contents = cell["parameters"].get(f"INIT_{letter}")
        if contents is not None:
            cell["parameters"][f"INIT{letter}"] = contents


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
