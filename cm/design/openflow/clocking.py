# SPDX-License-Identifier: Apache-2.0
"""What registers and memories are clocked by: the one clock, at its rising edge.

nextpnr 0.11 takes all edges for rising ones where it measures paths, and measures none between clocks. It forgets that
a shift register in look-up tables shifts at the falling edge, and puts flip-flops of both edges into one slice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from cm.design.errors import BuildError
from cm.design.openflow.merge import CLOCK
from cm.design.openflow.netlists import HARNESS

Cell = dict[str, Any]
_PINS = {"FD": ("C",), "SRL": ("CLK",), "RAMB": ("CLKARDCLK", "CLKBWRCLK"), "RAM": ("WCLK",), "DSP": ("CLK",)}
_CONSTANTS = frozenset("01xz")


def check_clocks(netlist: dict[str, Any], top: str, what: str) -> None:
    """Raise BuildError where a cell of yosys' netlist has another clock than the design, or its falling edge."""
    module = netlist["modules"][top]
    every = module.get("netnames", {}).items()
    names = {wire: name for name, net in every if not net["hide_name"] for wire in net["bits"]}
    told = [f"{name} ({kind}) {wrong}" for name, kind, wrong in _wrong(module["cells"], names)]
    if told:
        few = ", ".join(told[:3]) + (f" and {len(told) - 3} more" if len(told) > 3 else "")
        raise BuildError(
            f"{what}: {few}: the open tools time nothing but the rising edge of the one clock; use always @(posedge) "
            "of the module's clock port, and an enable in place of a divided or gated clock"
        )


def _wrong(cells: Mapping[str, Cell], names: Mapping[object, str]) -> Iterator[tuple[str, str, str]]:
    """Names of cells, by a wire that they drive where the source has a name for it; their kinds; what is wrong."""
    drivers = {wire: name for name, cell in cells.items() for wire in _outputs(cell)}
    for name, cell in sorted(cells.items()):
        pins = next((pins for kind, pins in _PINS.items() if cell["type"].startswith(kind)), ())
        if _last(name).startswith(HARNESS):
            continue
        shown = next((names[wire] for wire in _outputs(cell) if wire in names), name)
        if cell["type"].endswith("_1") or any("1" in cell["parameters"].get(f"IS_{pin}_INVERTED", "") for pin in pins):
            yield shown, cell["type"], "works at the falling edge"
            continue
        wires = {wire for pin in pins for wire in cell["connections"].get(pin, ())} - _CONSTANTS
        other = sorted((wire for wire in wires if _last(drivers.get(wire, "")) != CLOCK), key=str)
        if other:
            by = names.get(other[0]) or drivers.get(other[0], "a port")
            yield shown, cell["type"], f"is clocked by {by}"


def _outputs(cell: Cell) -> Iterator[object]:
    for pin, wires in cell["connections"].items():
        if cell["port_directions"].get(pin) == "output":
            yield from wires


def _last(name: str) -> str:
    return name.rpartition(".")[2]
