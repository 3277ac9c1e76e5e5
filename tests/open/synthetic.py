# SPDX-License-Identifier: Apache-2.0
"""Random modules: tables, carries, wide multiplexers, memory and shift registers in tables, block RAM, multipliers.

All have a stream in, a stream out and registers. Everything that holds a value has one to begin with, so that
Verilog and bits can be compared from the first cycle on.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from verilog_ports import AXI_LITE, STREAMS

# What a region must have for a kind of block: 'M' slices with memory, 'B' block RAM, 'D' DSP48
NEEDS = {"shift": "M", "tap": "M", "memory": "M", "block": "B", "product": "D"}


@dataclass(frozen=True, slots=True)
class Ports:
    """The widths of a module's streams."""

    into: int
    out: int


class Drawing:
    """One module being drawn: values `v0`, `v1`, …, each of some width, are made of earlier ones."""

    def __init__(self, source: random.Random, has: str) -> None:
        self._source, self._has = source, has
        self._widths: list[int] = []
        self._lines: list[str] = []

    def text(self, name: str, ports: Ports, blocks: int) -> str:
        """The module, of so many blocks."""
        self._value(ports.into, "s_axis_tdata")
        self._value(20, "{s_axis_tlast, take, held, s_axi_wstrb, s_axi_awaddr[7:2], s_axi_wdata[6:0]}")
        for _ in range(blocks):
            kinds = [kind for kind in _BLOCKS if NEEDS.get(kind, "") in self._has]
            getattr(self, f"_{self._source.choice(kinds)}")()
        body = "\n".join(self._lines)
        return _MODULE.format(
            name=name,
            high_in=ports.into - 1,
            high_out=ports.out - 1,
            body=body,
            mixed=self._folded(ports.out),
            read=self._folded(32),
            ident=self._source.getrandbits(32),
        )

    def _pick(self, width: int) -> str:
        """An expression of so many bits."""
        number = self._source.randrange(len(self._widths))
        have = self._widths[number]
        if have >= width:
            low = self._source.randint(0, have - width)
            return f"v{number}[{low + width - 1}:{low}]"
        return f"{{{', '.join([f'v{number}'] * (-(-width // have)))}}}"

    def _bit(self) -> str:
        return self._pick(1)

    def _folded(self, width: int) -> str:
        """All values, so that nothing is left out of the netlist."""
        parts = []
        for number, have in enumerate(self._widths):
            for low in range(0, have, width):
                high = min(low + width, have) - 1
                parts.append(f"v{number}[{high}:{low}]")
        return " ^ ".join(parts)

    def _value(self, width: int, expression: str) -> None:
        self._lines.append(f"    wire [{width - 1}:0] v{len(self._widths)} = {expression};")
        self._widths.append(width)

    def _name(self) -> str:
        return f"b{len(self._widths)}"

    def _width(self) -> int:
        return self._source.choice((1, 3, 4, 7, 8, 9, 12, 16, 17))

    def _register(self, width: int, next_value: str) -> str:
        """A register of one of the kinds that slices have; returns its name."""
        name = self._name()
        first, reset = self._source.getrandbits(width), self._source.getrandbits(width)
        self._lines.append(f"    reg [{width - 1}:0] {name} = {width}'h{first:x};")
        enabled = f"if ({self._bit()}) " if self._source.random() < 0.5 else ""
        cleared = self._source.choice(("", "", "now", "clocked", "at any time"))
        step = f"{enabled}{name} <= {next_value};"
        edge = "posedge aclk"
        if cleared == "at any time":
            edge += f" or negedge {'aresetn'}"
            step = f"if (!aresetn) {name} <= {width}'h{reset:x}; else {step}"
        elif cleared:
            signal = "!aresetn" if cleared == "clocked" else f"&{self._pick(3)}"
            step = f"if ({signal}) {name} <= {width}'h{reset:x}; else {step}"
        self._lines.append(f"    always @({edge}) {step}")
        return name

    def _logic(self) -> None:
        width = self._width()
        operators = ("^", "&", "|", "~^", "+")
        terms = [self._pick(width) for _ in range(self._source.randint(2, 4))]
        text = terms[0]
        for term in terms[1:]:
            text = f"({text} {self._source.choice(operators)} {'~' * self._source.randint(0, 1)}{term})"
        self._value(width, self._register(width, text))

    def _sum(self) -> None:
        width = self._source.choice((5, 8, 13, 16, 24, 32))
        sign = self._source.choice("+-")
        name = self._name()
        text = f"({name} {sign} {{{self._pick(width)}}} {self._source.choice('+-')} {self._bit()})"
        self._value(width, self._register(width, text))

    def _compare(self) -> None:
        width = self._source.choice((6, 11, 16))
        one, two = self._pick(width), self._pick(width)
        text = f"{{{one} < {two}, $signed({one}) >= $signed({two}), {one} == {two}}}"
        self._value(3, self._register(3, text))

    def _choice(self) -> None:
        """A table of constants, or one of many values: F7 and F8."""
        width, select = self._source.choice((2, 5, 8)), self._source.choice((3, 4, 5, 6, 7))
        name = self._name()
        constant = self._source.random() < 0.5
        rows = [
            f"            {select}'d{at}: {name}_c = "
            + (f"{width}'h{self._source.getrandbits(width):x};" if constant else f"{self._pick(width)};")
            for at in range(1 << select)
        ]
        self._lines.append(f"    reg [{width - 1}:0] {name}_c;")
        self._lines.append(f"    wire [{select - 1}:0] {name}_s = {self._pick(select)};")
        self._lines.append("    always @*\n        case (" + f"{name}_s)\n" + "\n".join(rows))
        self._lines.append(f"            default: {name}_c = {width}'d0;\n        endcase")
        plain = self._source.random() < 0.2
        self._value(width, f"{name}_c" if plain else self._register(width, f"{name}_c"))

    def _shift(self) -> None:
        length, name = self._source.randint(2, 70), self._name()
        self._lines.append(f"    reg [{length - 1}:0] {name} = {length}'h{self._source.getrandbits(length):x};")
        enabled = f"if ({self._bit()}) " if self._source.random() < 0.6 else ""
        self._lines.append(f"    always @(posedge aclk) {enabled}{name} <= {{{name}, {self._bit()}}};")
        self._value(1, f"{name}[{length - 1}]")

    def _tap(self) -> None:
        """A shift register that is read anywhere."""
        bits, name = self._source.choice((4, 5)), self._name()
        length = 1 << bits
        self._lines.append(f"    reg [{length - 1}:0] {name} = {length}'h{self._source.getrandbits(length):x};")
        self._lines.append(f"    always @(posedge aclk) if ({self._bit()}) {name} <= {{{name}, {self._bit()}}};")
        self._lines.append(f"    wire [{bits - 1}:0] {name}_a = {self._pick(bits)};")
        self._value(1, f"{name}[{name}_a]")

    def _memory(self) -> None:
        self._array(self._source.choice((4, 5, 6, 7, 8)), self._source.choice((1, 2, 3, 6, 8)), "distributed")

    def _block(self) -> None:
        self._array(self._source.choice((9, 10, 11)), self._source.choice((2, 4, 8, 9, 16)), "block")

    def _array(self, bits: int, width: int, style: str) -> None:
        name, depth = self._name(), 1 << bits
        self._lines.append(f'    (* ram_style = "{style}" *) reg [{width - 1}:0] {name}_m [0:{depth - 1}];')
        first = self._source.getrandbits(width)
        self._lines.append(
            f"    initial for (k = 0; k < {depth}; k = k + 1) {name}_m[k] = {width}'h{first:x} ^ k * "
            f"{self._source.choice((0, 1, 5))};"
        )
        write, read = self._pick(bits), self._pick(bits)
        same = self._source.random() < 0.3
        self._lines.append(f"    wire [{bits - 1}:0] {name}_w = {write}, {name}_r = {write if same else read};")
        self._lines.append(f"    always @(posedge aclk) if ({self._bit()}) {name}_m[{name}_w] <= {self._pick(width)};")
        if style == "block":
            self._lines.append(f"    reg [{width - 1}:0] {name} = {width}'d0;")
            enabled = f"if ({self._bit()}) " if self._source.random() < 0.5 else ""
            self._lines.append(f"    always @(posedge aclk) {enabled}{name} <= {name}_m[{name}_r];")
            self._value(width, name)
        else:
            # Not with an asynchronous reset: Verilator 5.006 would read what is written in the same cycle
            self._value(width, self._register_of(f"{name}_m[{name}_r]", width))

    def _product(self) -> None:
        one, two = self._source.choice((8, 12, 17, 18)), self._source.choice((6, 9, 16, 18))
        left, right = self._register_of(self._pick(one), one), self._register_of(self._pick(two), two)
        signed = self._source.random() < 0.5
        text = f"$signed({left}) * $signed({right})" if signed else f"{left} * {right}"
        self._value(one + two, self._register_of(text, one + two))

    def _register_of(self, text: str, width: int) -> str:
        name = f"p{len(self._lines)}"
        self._lines.append(f"    reg [{width - 1}:0] {name} = {width}'d0;")
        self._lines.append(f"    always @(posedge aclk) {name} <= {text};")
        return name


_BLOCKS = ("logic", "sum", "compare", "choice", "shift", "tap", "memory", "block", "product")


def draw_module(source: random.Random, name: str, ports: Ports, has: str, blocks: int) -> str:
    """The Verilog of a random module for a region that has block RAM ('B'), DSP48 ('D'), slices with memory ('M')."""
    return Drawing(source, has).text(name, ports, blocks)


_MODULE = (
    """\
module {name} (
    input  wire        aclk,
    input  wire        aresetn,
"""
    + STREAMS.rstrip()
    + ",\n"
    + AXI_LITE
    + """\
);
    integer k;
    wire take = s_axis_tvalid && s_axis_tready;
    reg  held = 1'b0, last = 1'b0, answers = 1'b0, told = 1'b0;
    reg  [{high_out}:0] result = 0;
    reg  [31:0] word = 32'd0, scratch = 32'd0;
    wire writes = s_axi_awvalid && s_axi_wvalid && !answers;
    wire reads = s_axi_arvalid && !told;
    assign s_axis_tready = !held || m_axis_tready;
    assign m_axis_tvalid = held;
    assign m_axis_tdata = result;
    assign m_axis_tlast = last;
    assign s_axi_awready = writes;
    assign s_axi_wready = writes;
    assign s_axi_bvalid = answers;
    assign s_axi_arready = reads;
    assign s_axi_rvalid = told;
    assign s_axi_rdata = word;
    assign s_axi_bresp = 2'b00;
    assign s_axi_rresp = 2'b00;

{body}

    always @(posedge aclk)
        if (!aresetn) held <= 1'b0;
        else if (s_axis_tready) begin
            held <= take;
            if (take) begin
                result <= {mixed};
                last <= s_axis_tlast;
            end
        end

    always @(posedge aclk)
        if (!aresetn) begin
            answers <= 1'b0;
            told <= 1'b0;
        end else begin
            if (writes) begin
                answers <= 1'b1;
                scratch <= s_axi_wdata ^ {{32{{s_axi_wstrb[3]}}}};
            end else if (s_axi_bready) answers <= 1'b0;
            if (reads) begin
                told <= 1'b1;
                case (s_axi_araddr[4:2])
                    3'd0: word <= 32'h{ident:08x};
                    3'd1: word <= scratch;
                    default: word <= {read};
                endcase
            end else if (s_axi_rready) told <= 1'b0;
        end
endmodule
"""
)
