# SPDX-License-Identifier: Apache-2.0
"""A netlist as Verilog, for a compiler that makes it fast."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from cm.frozen import dataclass
from cm.simulation.bits.cells import (
    ONE,
    ZERO,
    BlockMemory,
    BlockPort,
    Carry,
    Cell,
    Dsp,
    FlipFlop,
    Lut,
    LutMemory,
    Mux,
    Net,
    Netlist,
)
from cm.simulation.bits.extract import needs, nets_of

_DSP48 = Path(__file__).with_name("dsp48.v")
_BIT = re.compile(r"port:(\w+)(?:\[(\d+)\])?")


@dataclass(frozen=True, slots=True)
class Port:
    """A port of the module that is written."""

    name: str
    width: int
    into: bool


def verilog(netlist: Netlist, module: str, ports: Sequence[Port], clocks: Mapping[int, str]) -> str:
    """Return a module; `clocks`: the port of each clock line.

    Other lines do not toggle; outputs without a net are 0.
    """
    return "\n".join(_Writer(netlist, ports, clocks).lines(module)) + "\n"


class _Writer:
    def __init__(self, netlist: Netlist, ports: Sequence[Port], clocks: Mapping[int, str]) -> None:
        self._netlist, self._ports, self._clocks = netlist, ports, clocks
        self._wide = {port.name for port in ports if port.width > 1}
        used = {net for cell in netlist.cells for net in needs(cell)} | set(netlist.outputs.values())
        made = [net for cell in netlist.cells for net in nets_of(cell) if net in used]
        self._names = {net: f"n{number}" for number, net in enumerate(made)}

    def lines(self, module: str) -> Iterator[str]:
        yield "// What the frames of a bitstream configure."
        yield "/* verilator lint_off UNOPTFLAT */"
        yield f"module {module} ("
        yield ",\n".join(map(_declared, self._ports))
        yield ");"
        for net, name in self._names.items():
            yield f"    wire {name};  // {net}"
        for number, cell in enumerate(self._netlist.cells):
            yield from self._cell(cell, f"c{number}")
        for port in self._ports:
            if not port.into:
                yield from self._output(port)
        yield "endmodule"
        if any(isinstance(cell, Dsp) for cell in self._netlist.cells):
            yield _DSP48.read_text("utf-8")

    def _output(self, port: Port) -> Iterator[str]:
        for bit in range(port.width):
            name = port.name if port.width == 1 else f"{port.name}[{bit}]"
            yield f"    assign {name} = {self._net(self._netlist.outputs.get(name, ZERO))};"

    def _net(self, net: Net) -> str:
        if net in (ZERO, ONE):
            return f"1'b{net}"
        if net.startswith("clock:"):
            return self._clocks.get(int(net.removeprefix("clock:")), "1'b0")
        found = _BIT.fullmatch(net)
        if found is not None:
            return f"{found[1]}[{found[2]}]" if found[2] is not None and found[1] in self._wide else found[1]
        return self._names[net]

    def _bits(self, nets: Sequence[Net]) -> str:
        """The first one lowest."""
        return "{" + ", ".join(self._net(net) for net in reversed(nets)) + "}"

    def _cell(self, cell: Cell, name: str) -> Iterator[str]:
        if isinstance(cell, Lut):
            yield from self._lut(cell, name)
        elif isinstance(cell, Mux):
            output, select, one, zero = map(self._net, (cell.output, cell.select, cell.one, cell.zero))
            yield f"    assign {output} = {select} ? {one} : {zero};"
        elif isinstance(cell, Carry):
            yield from self._carry(cell, name)
        elif isinstance(cell, FlipFlop):
            yield from self._storage(cell, name)
        elif isinstance(cell, BlockMemory):
            yield from self._block(cell, name)
        elif isinstance(cell, Dsp):
            yield from self._dsp(cell, name)
        else:
            yield from self._memory(cell, name)

    def _lut(self, cell: Lut, name: str) -> Iterator[str]:
        width = 1 << len(cell.inputs)
        if not cell.inputs:
            yield f"    assign {self._names[cell.output]} = 1'b{cell.init & 1};"
            return
        yield f"    wire [{width - 1}:0] {name} = {width}'h{cell.init:x};"
        yield f"    assign {self._names[cell.output]} = {name}[{self._bits(cell.inputs)}];"

    def _reads(self, cell: LutMemory, table: str) -> Iterator[str]:
        low = [ZERO, *cell.inputs[1:]] if cell.shifts else list(cell.inputs)
        if cell.o6 in self._names:
            yield f"    assign {self._names[cell.o6]} = {table}[{self._bits(low)}];"
        if cell.o5 in self._names:
            yield f"    assign {self._names[cell.o5]} = {table}[{self._bits([*low[:5], ZERO])}];"

    def _carry(self, cell: Carry, name: str) -> Iterator[str]:
        carry = self._net(cell.begin)
        for bit, (select, data) in enumerate(zip(cell.select, cell.data, strict=True)):
            chosen = self._net(select)
            if cell.sums[bit] in self._names:
                yield f"    assign {self._names[cell.sums[bit]]} = {chosen} ^ {carry};"
            yield f"    wire {name}_{bit} = {chosen} ? {carry} : {self._net(data)};"
            carry = f"{name}_{bit}"
            if cell.carries[bit] in self._names:
                yield f"    assign {self._names[cell.carries[bit]]} = {carry};"

    def _storage(self, cell: FlipFlop, name: str) -> Iterator[str]:
        clock, data, enable, reset = map(self._net, (cell.clock, cell.data, cell.enable, cell.reset))
        yield f"    reg {name} = 1'b{int(cell.init)};"
        yield f"    assign {self._net(cell.output)} = {name};"
        value = f"1'b{int(cell.value)}"
        step = f"if ({reset}) {name} <= {value}; else if ({enable}) {name} <= {data};"
        if cell.latch:
            level = f"!{clock}" if cell.inverted else clock
            yield f"    always @* if ({reset}) {name} = {value}; else if ({level} && {enable}) {name} = {data};"
        elif clock in ("1'b0", "1'b1"):
            return
        elif cell.synchronous or reset == "1'b0":
            yield f"    always @({_edge(cell.inverted)} {clock}) {step}"
        else:
            yield f"    always @({_edge(cell.inverted)} {clock} or posedge {reset}) {step}"

    def _block(self, cell: BlockMemory, name: str) -> Iterator[str]:
        depth, top = len(cell.words), cell.width - 1
        yield f"    reg [{top}:0] {name} [0:{depth - 1}];"
        full = " ".join(f"{name}[{at}] = {cell.width}'h{word:x};" for at, word in enumerate(cell.words) if word)
        yield f"    integer {name}i;"
        each = f"{name}i = 0; {name}i < {depth}; {name}i = {name}i + 1"
        yield f"    initial begin for ({each}) {name}[{name}i] = 0; {full} end"
        for letter, port in zip("ab", cell.ports, strict=True):
            yield from self._block_port(cell, port, name, name + letter)

    def _block_port(self, cell: BlockMemory, port: BlockPort, name: str, own: str) -> Iterator[str]:
        used = [(bit, net) for bit, net in enumerate(port.outputs) if net in self._names]
        if not used and not port.data:
            return
        clock, enable, reset = (
            f"{'!' if inverted else ''}{self._net(net)}" for net, inverted in (port.clock, port.enable, port.reset)
        )
        yield f"    reg [{cell.width - 1}:0] {own} = {cell.width}'h{port.init:x};"
        for bit, net in used:
            yield f"    assign {self._names[net]} = {own}[{bit}];"
        if clock.lstrip("!") in ("1'b0", "1'b1"):
            return
        yield f"    wire [{len(port.address) - 1}:0] {own}_at = {self._bits(port.address)};"
        writes, written = [], f"{name}[{own}_at]"
        bits = cell.width - cell.width // 9
        for lane, net in enumerate(port.lanes):
            low, high = (8 * lane, 8 * lane + 7) if bits >= 8 else (0, bits - 1)
            parts = [(high, low), (bits + lane, bits + lane)] if cell.width >= 9 else [(high, low)]
            writes += [f"if ({self._net(net)}) {written}[{top}:{end}] <= {own}_in[{top}:{end}];" for top, end in parts]
        anything = " || ".join(map(self._net, port.lanes)) or "1'b0"
        if port.data:
            yield f"    wire [{cell.width - 1}:0] {own}_in = {self._bits(port.data)};"
        seen = {"READ_FIRST": written, "NO_CHANGE": f"({anything}) ? {own} : {written}"}.get(
            port.mode, f"({anything}) ? {own}_in : {written}" if port.data else written
        )
        read = f"{own} <= {reset} ? {cell.width}'h{port.value:x} : {seen};" if used else ""
        edge, plain = ("negedge", clock[1:]) if clock.startswith("!") else ("posedge", clock)
        yield f"    always @({edge} {plain}) if ({enable}) begin {read} {' '.join(writes)} end"

    def _dsp(self, cell: Dsp, name: str) -> Iterator[str]:
        parameters = ", ".join(f".{parameter}({value})" for parameter, value in cell.parameters)
        ports = []
        for port, pins in cell.pins:
            bits = (f"{'!' if inverted else ''}{self._net(net)}" for net, inverted in reversed(pins))
            ports.append(f".{port}({{{', '.join(bits)}}})")
        yield f"    wire [47:0] {name};"
        yield f"    cm_dsp48 #({parameters}) {name}_cell ({', '.join(ports)}, .P({name}));"
        for bit, net in enumerate(cell.outputs):
            if net in self._names:
                yield f"    assign {self._names[net]} = {name}[{bit}];"

    def _memory(self, cell: LutMemory, name: str) -> Iterator[str]:
        clock = self._net(cell.clock)
        yield f"    reg [63:0] {name} = 64'h{cell.init:016x};"
        yield from self._reads(cell, name)
        if cell.last in self._names:
            yield f"    assign {self._names[cell.last]} = {name}[63];"
        if clock in ("1'b0", "1'b1"):
            return
        enable = " && ".join(f"{'' if wanted else '!'}{self._net(net)}" for net, wanted in cell.enables)
        data, high = self._net(cell.data), self._net(cell.high_data)
        if cell.shifts and cell.small:
            change = f"{name} <= {{{name}[61:32], {{2{{{high}}}}}, {name}[29:0], {{2{{{data}}}}}}};"
        elif cell.shifts:
            change = f"{name} <= {{{name}[61:0], {{2{{{data}}}}}}};"
        elif cell.small:
            address = self._bits(cell.write[:5])
            change = f"begin {name}[{{1'b1, {address}}}] <= {high}; {name}[{{1'b0, {address}}}] <= {data}; end"
        else:
            change = f"{name}[{self._bits(cell.write)}] <= {data};"
        yield f"    always @({_edge(cell.inverted)} {clock}) if ({enable}) {change}"


def _declared(port: Port) -> str:
    vector = f"[{port.width - 1}:0] " if port.width > 1 else ""
    return f"    {'input ' if port.into else 'output'} wire {vector}{port.name}"


def _edge(inverted: bool) -> str:
    return "negedge" if inverted else "posedge"
