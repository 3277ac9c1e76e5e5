# SPDX-License-Identifier: Apache-2.0
"""Inserts a look-up table between an anchor and a flip-flop that it feeds, in yosys' JSON.

nextpnr packs a look-up table and the flip-flop behind it into one cluster, and crashes in `dict::at()` if the
look-up table has a fixed place.
"""

from __future__ import annotations

from typing import Any

from cm.design.openflow.netlists import ANCHOR

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
