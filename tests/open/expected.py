# SPDX-License-Identifier: Apache-2.0
"""What a changed design does, in yosys' models of cells and by Icarus: nothing of `cm.simulation.bits`.

Many changed designs go into one run.
"""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from changes import Change
from design import Cell, Design

CELLS = Path("/usr/share/yosys/xilinx/cells_sim.v")
LOOP = 2  # seconds of a processor for what takes 30 ms
_STORED = ("LUT", "FD", "LD", "SRL", "RAMD32")


def outputs(folder: Path, design: Design, changes: Sequence[Change], values: Sequence[int]) -> list[list[int]]:
    """What comes out after each clock, for each change; -1 where the models do not know."""
    modules = [_module(design, change) for change in changes]
    return simulated(folder, modules, [circular(design, change) for change in changes], values)


def simulated(folder: Path, modules: Sequence[str], circles: Sequence[bool], values: Sequence[int]) -> list[list[int]]:
    """What modules `design@` of `clk`, `a` and `y` put out after each clock; -1 where that is not known.

    Those with `circles` may simulate without end, and each runs alone.
    """
    together = [module for module, circle in zip(modules, circles, strict=True) if not circle]
    found = iter(_run(folder, together, values) if together else [])
    return [
        _alone(folder, module, values) if circle else next(found)
        for module, circle in zip(modules, circles, strict=True)
    ]


def circular(design: Design, change: Change) -> bool:
    """Whether something may depend on itself without a register between."""
    after: dict[object, set[object]] = {}
    for cell in design.cells.values():
        now = change.cells.get(cell.name, cell)
        for pin, output in _ways_through(now):
            source = now.nets.get(pin) if pin in now.ports else (now.name, pin)
            target = now.nets.get(output) if output in now.ports else (now.name, output)
            for one in change.pins.get((cell.name, pin), (source,)):
                if one is not None and target is not None:
                    after.setdefault(one, set()).add(target)
    try:
        list(TopologicalSorter(after).static_order())
    except CycleError:
        return True
    return False


def _ways_through(cell: Cell) -> Iterator[tuple[str, str]]:
    """From which pins of a cell to which others there is a way without a clock; carries are pins of their own here."""
    if cell.kind == "CARRY4":
        yield from (("CIN", "c0"), ("CYINIT", "c0"))
        for n in range(4):
            yield from ((f"S{n}", f"O{n}"), (f"c{n}", f"O{n}"), (f"c{n + 1}", f"CO{n}"))
            yield from ((source, f"c{n + 1}") for source in (f"c{n}", f"S{n}", f"DI{n}"))
    elif not cell.kind.startswith("FD"):
        outs = [pin for pin in cell.nets if pin.startswith(("O", "Q"))]
        clocked = ("WA", "WE", "DI", "CLK") if cell.kind.startswith(("RAM", "SRL")) else ()
        yield from ((pin, out) for pin in cell.nets if not pin.startswith((*clocked, "O", "Q")) for out in outs)


def _alone(folder: Path, module: str, values: Sequence[int]) -> list[int]:
    try:
        return _run(folder, [module], values)[0]
    except subprocess.CalledProcessError as problem:
        if problem.returncode != -signal.SIGXCPU:
            raise
        return [-1] * len(values)  # it simulates without end


def _run(folder: Path, modules: Sequence[str], values: Sequence[int]) -> list[list[int]]:
    text = "".join(module.replace("design@", f"design{number}") for number, module in enumerate(modules))
    wires = "".join(f"wire [7:0] y{n}; design{n} d{n} (clk, a, y{n});\n" for n in range(len(modules)))
    shown = f'$display("{" %b" * len(modules)}", {", ".join(f"y{n}" for n in range(len(modules)))});'
    steps = "".join(f"a = {value}; #10 clk = 1; #10 clk = 0; #10 show;\n" for value in values)
    bench = f"module bench; reg clk = 0; reg [7:0] a = 0;\n{wires}task show; {shown} endtask\n"
    bench += f"initial begin #200\n{steps}end\nendmodule\n"
    (folder / "expected.v").write_text(text + _MODELS + bench)
    command = ["iverilog", "-g2012", "-s", "bench", "-o", str(folder / "bench"), str(folder / "expected.v"), str(CELLS)]
    subprocess.run(command, check=True, capture_output=True)
    limit = LOOP * len(modules)  # seconds of a processor
    run = ["/bin/sh", "-c", f'ulimit -S -t {limit}; exec "$0"', str(folder / "bench")]
    done = subprocess.run(run, check=True, capture_output=True, text=True)
    rows = [line.split() for line in done.stdout.splitlines()]
    return [[_number(row[column]) for row in rows] for column in range(len(modules))]


def _number(word: str) -> int:
    return int(word, 2) if set(word) <= {"0", "1"} else -1


def _module(design: Design, change: Change) -> str:
    """The design with `a` at the begin of its anchors and `y` behind them."""
    body, wires = [], set()
    for cell in design.cells.values():
        if cell.outside:
            continue
        now = change.cells.get(cell.name, cell)
        pins: dict[str, dict[int, str]] = {}
        for pin, port in now.ports.items():
            nets = change.pins.get((cell.name, pin), (now.nets.get(pin),))
            value = " & ".join(_wire(design, net, pin) for net in nets) if nets else "1'b1"
            base, _, index = port.partition("[")
            pins.setdefault(base, {})[int(index.rstrip("]") or 0) if index else -1] = value
            wires |= {net for net in nets if net is not None}
        body.append(_instance(now, pins, len(body)))
    wires -= {design.one, design.zero, design.clock}
    begins = {_bit(cell): cell.nets["Q"] for cell in design.cells.values() if "begins" in cell.name}
    leaves = {_bit(cell): cell.nets["O6"] for cell in design.cells.values() if "leaves" in cell.name}
    lines = ["module design@ (input wire clk, input wire [7:0] a, output wire [7:0] y);"]
    lines += [f"wire n{net};" for net in sorted(wires | set(begins.values()))]
    lines += [f"assign n{net} = a[{bit}];" for bit, net in begins.items()]
    lines += [f"assign y[{bit}] = n{net};" for bit, net in leaves.items()]
    return "\n".join([*lines, *body, "endmodule\n"])


def _bit(cell: Cell) -> int:
    return int(cell.name.split("[")[1].split("]")[0])


def _wire(design: Design, net: int | None, pin: str) -> str:
    if net is None:
        return "" if pin.startswith(("O", "CO", "Q")) else "1'b0"
    return {design.one: "1'b1", design.zero: "1'b0", design.clock: "clk"}.get(net, f"n{net}")


def _instance(cell: Cell, pins: Mapping[str, Mapping[int, str]], number: int) -> str:
    """A cell; a bit of a vector that nothing hangs on gets a wire of its own."""
    text, wires = [], []
    for name, bits in pins.items():
        if -1 in bits:
            value = bits[-1]
            if cell.kind.startswith("LD") and name == "Q":  # a latch opens later than registers look at it
                wires.append(f"wire q{number}; assign #1 {value} = q{number};")
                value = f"q{number}"
            text.append(f".{name}({value})")
            continue
        values = []
        for bit in reversed(range(max(bits) + 1)):
            value = bits.get(bit, "1'b0")
            if not value:
                value = f"u{number}_{name}_{bit}"
                wires.append(f"wire {value};")
            values.append(value)
        text.append(f".{name}({{{', '.join(values)}}})")
    parameters = dict(cell.parameters)
    if cell.kind.startswith(_STORED):
        parameters["INIT"] = f"{len(cell.init)}'b{cell.init}"
    init = "#(" + ", ".join(f".{name}({value})" for name, value in parameters.items()) + ") " if parameters else ""
    return f"{' '.join(wires)} {cell.kind} {init}c{number} ({', '.join(text)});"


_MODELS = """
module RAMD32 (output wire O, input wire CLK, I, WE,
    input wire RADR0, RADR1, RADR2, RADR3, RADR4, WADR0, WADR1, WADR2, WADR3, WADR4);
    parameter [31:0] INIT = 32'd0;
    parameter [0:0] IS_CLK_INVERTED = 1'b0;
    reg [31:0] memory = INIT;
    wire clock = CLK ^ IS_CLK_INVERTED;
    assign O = memory[{RADR4, RADR3, RADR2, RADR1, RADR0}];
    always @(posedge clock) if (WE) memory[{WADR4, WADR3, WADR2, WADR1, WADR0}] <= I;
endmodule
"""
