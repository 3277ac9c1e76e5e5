# SPDX-License-Identifier: Apache-2.0
"""What a flipped bit should do, from nextpnr's own routed design and yosys' models of cells: nothing of `cm.bits`.

A routed design says which cell stands where, which of its pins is which wire of the slice, and by which pips each net
goes. A flip changes a parameter of a cell, the kind of a cell, or cuts a branch of a net, whose pins then read 1.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

CELLS = Path("/usr/share/yosys/xilinx/cells_sim.v")
LOOP = 20.0  # seconds for what takes 30 ms
_BEL = re.compile(r"(X\d+Y\d+)/(SLICE_X\dY0)\.(\w+)")
_ASYNCHRONOUS = {"FDRE": "FDCE", "FDSE": "FDPE", "FDCE": "FDRE", "FDPE": "FDSE"}
_OTHER_VALUE = {"FDRE": "FDSE", "FDSE": "FDRE", "FDCE": "FDPE", "FDPE": "FDCE"}
_RESETS = {"FDRE": "R", "FDSE": "S", "FDCE": "CLR", "FDPE": "PRE"}
_SHIFTS = {
    "SRL16E": {f"A{bit + 2}": f"A{bit}" for bit in range(4)},
    "SRLC32E": {f"A{bit + 2}": f"A[{bit}]" for bit in range(5)},
}
_BYPASS = {  # what a bypass pin of a slice may lead to: element of the slice, pin of the cell
    "AX": (("F7AMUX", "S0"), ("AFF", "D"), ("A5FF", "D"), ("CARRY4", "DI0"), ("CARRY4", "CYINIT"), ("A6LUT", "DI2")),
    "BX": (("F8MUX", "S0"), ("BFF", "D"), ("B5FF", "D"), ("CARRY4", "DI1"), ("B6LUT", "DI2")),
    "CX": (("F7BMUX", "S0"), ("CFF", "D"), ("C5FF", "D"), ("CARRY4", "DI2"), ("C6LUT", "DI2")),
    "DX": (("DFF", "D"), ("D5FF", "D"), ("CARRY4", "DI3"), ("D6LUT", "DI2")),
}


@dataclass(frozen=True)
class Cell:
    """A cell of the routed design; `pins`: its original ports by its pins, with the net at each."""

    name: str
    kind: str
    init: str
    tile: str  # X87Y12
    site: str  # SLICE_X0Y0
    element: str  # A6LUT, B5FF
    nets: Mapping[str, int | None]
    ports: Mapping[str, str]


@dataclass(frozen=True)
class Change:
    """What is different about the design."""

    cells: Mapping[str, Cell] = field(default_factory=dict)
    cut: frozenset[tuple[str, str]] = frozenset()  # cell, pin: reads 1


class Design:
    """A routed design, and its behaviour with changes."""

    def __init__(self, netlist: Mapping[str, Any], routes: Mapping[str, Sequence[tuple[str, str, str]]]) -> None:
        nets = {name: net["bits"][0] for name, net in netlist["netnames"].items() if net["bits"]}
        self._routes = {nets[name]: ways for name, ways in routes.items() if name in nets}
        self._net_of = {pip: net for net, ways in self._routes.items() for _, _, pip in ways}
        self.cells = {cell.name: cell for cell in _cells(netlist["cells"])}
        self._one = next(c["connections"]["Y"][0] for c in netlist["cells"].values() if c["type"] == "PSEUDO_VCC")
        self._zero = next(c["connections"]["Y"][0] for c in netlist["cells"].values() if c["type"] == "PSEUDO_GND")
        self._clock = next(c["connections"]["O"][0] for c in netlist["cells"].values() if c["type"] == "BUFGCTRL")

    def at(self, tile: str, site: str, element: str) -> Cell | None:
        """The cell at a place."""
        return self._places.get((tile, site, element))

    @cached_property
    def _places(self) -> Mapping[tuple[str, str, str], Cell]:
        return {(cell.tile, cell.site, cell.element): cell for cell in self.cells.values()}

    def table_bit(self, tile: str, site: str, letter: str, bit: int) -> Change:
        """Bit `bit` of a look-up table's contents is the other one."""
        found = (self.at(tile, site, f"{letter}6LUT"), self.at(tile, site, f"{letter}5LUT"))
        changed = (self._with_bit(cell, bit) for cell in found if cell is not None)
        return Change({cell.name: cell for cell in changed if cell is not None})

    def _with_bit(self, cell: Cell, bit: int) -> Cell | None:
        """The cell as a table of all pins of the slice, so that it sees what stands at those that it did not use.

        The router exchanges pins and renames the cell's afterwards: they are those of the slice. None where the
        bit is one that the cell never reads.
        """
        size = int(cell.element[1])
        if bit >> size:
            return None
        routed = {pin: self._routed(cell, pin, net) for pin, net in cell.nets.items() if pin.startswith("A")}
        inputs = {pin: port for pin, port in cell.ports.items() if port.startswith("I")}
        contents = cell.init.rjust(1 << len(inputs), "0")
        table = []
        for address in range(1 << size):
            index = sum((address >> int(pin[1:]) - 1 & 1) << int(port[1:]) for pin, port in inputs.items())
            table.append(contents[-1 - index])
        table[bit] = "10"[int(table[bit])]
        nets = {**cell.nets, **{f"A{n}": routed.get(f"A{n}") or self._one for n in range(1, size + 1)}}
        ports = {f"A{n}": f"I{n - 1}" for n in range(1, size + 1)}
        ports |= {pin: port for pin, port in cell.ports.items() if pin.startswith("O")}
        return replace(cell, kind=f"LUT{size}", init="".join(reversed(table)), nets=nets, ports=ports)

    def _routed(self, cell: Cell, pin: str, net: int | None) -> int | None:
        """The net at a pin, where it is routed to it: what nothing is routed to reads 1."""
        wires = (before for wire, before, _ in self._routes.get(net or 0, ()) if wire.startswith(f"{cell.tile}/"))
        return net if any(before.endswith(f"_{cell.element[0]}{pin[1:]}") for before in wires) else None

    def storage(self, tile: str, site: str, element: str, what: str) -> Change:
        """ZINI, ZRST of one register, or FFSYNC of a slice."""
        chosen = [c for c in self.cells.values() if (c.tile, c.site) == (tile, site) and c.element.endswith("FF")]
        if what == "FFSYNC":
            return Change({c.name: _of_kind(c, _ASYNCHRONOUS[c.kind]) for c in chosen})
        one = next((c for c in chosen if c.element == element), None)
        if one is None:
            return Change()
        changed = replace(one, init=str(1 - int(one.init))) if what == "ZINI" else _of_kind(one, _OTHER_VALUE[one.kind])
        return Change({one.name: changed})

    def cut(self, pip: str) -> Change | None:
        """A pip is off: everything behind it reads 1. None where that is not all there is to it."""
        net = self._net_of.get(pip)
        if net is None:
            return None
        ways = self._routes[net]
        behind, grew = {wire for wire, _, own in ways if own == pip}, True
        while grew:
            more = {wire for wire, before, _ in ways if before in behind} - behind
            behind, grew = behind | more, bool(more)
        pins = {end for wire, before, _ in ways if wire in behind for end in self._ends(wire, before, net)}
        return Change(cut=frozenset(pins)) if pins else None

    def _ends(self, wire: str, before: str, net: int) -> Iterator[tuple[str, str]]:
        """Pins of cells that a pin of a slice leads to."""
        match = _BEL.fullmatch(wire)
        if match is None:
            return
        tile, site, pin = match.groups()
        if re.fullmatch(r"[A-D][1-6]", pin):
            pin = pin[0] + before[-1]  # of the slice
            ends: Sequence[tuple[str, str]] = [(f"{pin[0]}{size}LUT", f"A{pin[1]}") for size in "65"]
            if pin[0] == "D":  # the address of all tables that are written
                ends = [*ends, *((f"{letter}{size}LUT", f"WA{pin[1]}") for letter in "ABCD" for size in "65")]
        elif pin in ("CE", "SR", "CLK"):
            name = {"CLK": "CK"}.get(pin, pin)
            ends = [(f"{letter}{kind}", name) for letter in "ABCD" for kind in ("FF", "5FF")]
            ends = [*ends, *((f"{letter}6LUT", {"CLK": "CLK", "CE": "WE"}.get(pin, "-")) for letter in "ABCD")]
        else:
            ends = _BYPASS.get(pin, ())
        for element, end in ends:
            cell = self.at(tile, site, element)
            if cell is not None and cell.nets.get(end) == net:
                yield cell.name, end

    def verilog(self, change: Change) -> str:
        """The design with `a` at the begin of its anchors and `y` behind them, of yosys' cells."""
        body, wires = [], set()
        for cell in self.cells.values():
            if "begins" in cell.name or "ends" in cell.name:
                continue
            now = change.cells.get(cell.name, cell)
            pins: dict[str, dict[int, str]] = {}
            for pin, port in now.ports.items():
                net = now.nets.get(pin)
                name, _, index = port.partition("[")
                cut = (cell.name, pin) in change.cut
                value = "1'b1" if cut else self._wire(net, now.kind, pin)
                pins.setdefault(name, {})[int(index.rstrip("]") or 0) if index else -1] = value
                if net is not None:
                    wires.add(net)
            body.append(_instance(now, pins, len(body)))
        wires -= {self._one, self._zero, self._clock}
        begins = {
            int(c.name.split("[")[1].split("]")[0]): c.nets["Q"] for c in self.cells.values() if "begins" in c.name
        }
        leaves = {
            int(c.name.split("[")[1].split("]")[0]): c.nets["O6"] for c in self.cells.values() if "leaves" in c.name
        }
        lines = ["module expected (input wire clk, input wire [7:0] a, output wire [7:0] y);"]
        lines += [f"wire n{net};" for net in sorted(wires | set(begins.values()))]
        lines += [f"assign n{net} = a[{bit}];" for bit, net in begins.items()]
        lines += [f"assign y[{bit}] = n{net};" for bit, net in leaves.items()]
        return "\n".join([*lines, *body, "endmodule\n", _RAMD32])

    def _wire(self, net: int | None, kind: str, pin: str) -> str:
        if net == self._clock:
            return "clk"
        if net is None:
            return "" if pin.startswith(("O", "CO", "Q")) else "1'b0"
        return {self._one: "1'b1", self._zero: "1'b0"}.get(net, f"n{net}")


def run(folder: Path, verilog: str, values: Sequence[int]) -> list[int]:
    """What comes out after each clock, by Icarus."""
    steps = "".join(f"a = {value}; #1 clk = 1; #1 clk = 0; #1 $display(y);\n" for value in values)
    head = "module bench; reg clk = 0; reg [7:0] a = 0; wire [7:0] y; expected m (clk, a, y);"
    bench = f"{head}\ninitial begin #200\n{steps}end\nendmodule\n"
    (folder / "expected.v").write_text(verilog + bench)
    command = ["iverilog", "-g2012", "-s", "bench", "-o", str(folder / "bench"), str(folder / "expected.v"), str(CELLS)]
    subprocess.run(command, check=True, capture_output=True)
    try:
        done = subprocess.run([folder / "bench"], check=True, capture_output=True, text=True, timeout=LOOP)
    except subprocess.TimeoutExpired:  # a circle without a register, which simulates without end
        return [-1] * len(values)
    return [int(word) if word.isdigit() else -1 for word in done.stdout.split()]


def _cells(cells: Mapping[str, Any]) -> Iterator[Cell]:
    for name, cell in cells.items():
        attributes = cell["attributes"]
        match = _BEL.fullmatch(attributes.get("NEXTPNR_BEL", ""))
        if match is None or "X_ORIG_TYPE" not in attributes:
            continue
        ports = {
            key.removeprefix("X_ORIG_PORT_"): value.strip()
            for key, value in attributes.items()
            if key.startswith("X_ORIG_PORT_")
        }
        nets = {pin: (bits[0] if bits else None) for pin, bits in cell["connections"].items()}
        kind = attributes["X_ORIG_TYPE"]
        if kind in _SHIFTS:  # their attributes have the pins of before the packing
            ports = {pin: port for pin, port in ports.items() if not re.fullmatch(r"A\d", pin)} | _SHIFTS[kind]
        init = cell["parameters"].get("INIT", "0")
        yield Cell(name, kind, init, *match.groups(), nets, ports)


def _of_kind(cell: Cell, kind: str) -> Cell:
    """Another register: its reset has another name."""
    return replace(cell, kind=kind, ports={**cell.ports, "SR": _RESETS[kind]})


def _instance(cell: Cell, pins: Mapping[str, Mapping[int, str]], number: int) -> str:
    """A cell; a bit of a vector that nothing hangs on gets a wire of its own."""
    text, wires = [], []
    for name, bits in pins.items():
        if -1 in bits:
            text.append(f".{name}({bits[-1]})")
            continue
        values = []
        for bit in reversed(range(max(bits) + 1)):
            value = bits.get(bit, "1'b0")
            if not value:
                value = f"u{number}_{name}_{bit}"
                wires.append(f"wire {value};")
            values.append(value)
        text.append(f".{name}({{{', '.join(values)}}})")
    init = f"#(.INIT({_literal(cell)})) " if cell.kind.startswith(("LUT", "FD", "SRL")) else ""
    return f"{' '.join(wires)} {cell.kind} {init}c{number} ({', '.join(text)});"


def _literal(cell: Cell) -> str:
    return f"{len(cell.init)}'b{cell.init}"


_RAMD32 = """
module RAMD32 (output wire O, input wire CLK, I, WE,
    input wire RADR0, RADR1, RADR2, RADR3, RADR4, WADR0, WADR1, WADR2, WADR3, WADR4);
    reg [31:0] memory = 32'd0;
    assign O = memory[{RADR4, RADR3, RADR2, RADR1, RADR0}];
    always @(posedge CLK) if (WE) memory[{WADR4, WADR3, WADR2, WADR1, WADR0}] <= I;
endmodule
"""
