# SPDX-License-Identifier: Apache-2.0
"""Shift registers in look-up tables: workarounds for what nextpnr 0.11 cannot do with them, or does wrongly.

Inserts a look-up table between an anchor and a flip-flop that it feeds, in yosys' JSON.

nextpnr packs a look-up table and the flip-flop behind it into one cluster, and crashes in `dict::at()` if the
look-up table has a fixed place.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from cm.design.errors import BuildError
from cm.design.openflow.layout import site_kind
from cm.design.openflow.netlists import ANCHOR
from cm.design.openflow.routed import tile_of
from cm.formats.xray import Database, Feature

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
    used = {wire for cell in cells.values() for wire in _inputs(cell)}
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


def _inputs(cell: Cell) -> list[object]:
    return [
        wire
        for pin, wires in cell["connections"].items()
        if cell["port_directions"].get(pin) == "input"
        for wire in wires
    ]


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
