# SPDX-License-Identifier: Apache-2.0
"""Modules twice, by their bits and by their Verilog, with the same random input in each cycle."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from cm.design.openflow.layout import layouts
from cm.formats.bitstream import device_by_name
from cm.formats.bitstream.memory import FrameMemory
from cm.formats.xray import Database, Feature, Wires, decode
from cm.simulation.bits import Boundary, Netlist, Port, extract, verilog
from cm.simulation.bits.cells import Lut
from cm.simulation.bits.main import collected, streams_of
from cm.simulation.bits.regions import Place
from cm.simulation.rtl.design import RtlDesign, load_rtl_design

# Random beats and accesses, seldom a reset; TLAST about once in a line.
_TWIN = """
module twin_@NAME@ (input wire clk, input wire begun, output reg [31:0] wrong, output reg [31:0] changes);
    reg [127:0] noise = 128'h0123456789abcdef_fedcba9876543210;
    reg [31:0] cycle = 0;
    initial wrong = 0;
    initial changes = 0;
    wire resetn = !begun || (cycle > 20 && noise[127:116] != 12'd0);  // falls before the first clock
@WIRES@
    rtl_@NAME@ rtl (@RTL@);
    bits_@NAME@ frames (@BITS@);
    wire [@HIGH@:0] one = {@ONE@}, two = {@TWO@};
    reg [@HIGH@:0] earlier = 0;
    always @(negedge clk) begin  // not with the edge that counts: resets may come at any time
        cycle <= cycle + 1;
        noise <= {noise[126:0], noise[127] ^ noise[125] ^ noise[100] ^ noise[98]};
    end
    always @(posedge clk) begin
        earlier <= one;
        if (cycle >= 32'd@FIRST@ && one != two) wrong <= wrong + 1;
        if (one != earlier) changes <= changes + 1;
    end
endmodule
"""
_MAIN = """
#include "Vtwins.h"
#include <cstdio>
int main() {
    Vtwins top;
    top.clk = 0; top.eval();  // first values, before the first edge
    top.begun = 1; top.eval();  // Verilog resets at an edge, a flip-flop as long as it lasts
    for (long cycle = 0; cycle < @CYCLES@; cycle++) {
        top.clk = 1; top.eval();
        top.clk = 0; top.eval();
    }
@PRINT@
}
"""


class Compared(NamedTuple):
    """Of a module: cycles in which its outputs differed, and in which they changed."""

    wrong: int
    changes: int


@dataclass(frozen=True, slots=True)
class Twin:
    """A module of a region as both; `sources` are its Verilog, whose top is the region's module.

    `tied`: the wires into the region that the static part holds at a value, as where `connect: none` is.
    """

    name: str
    netlist: Netlist
    place: Place
    sources: tuple[Path, ...]
    tied: Mapping[str, bool]


class Built:
    """A project whose flow has finished."""

    def __init__(self, project: Path, folder: Path) -> None:
        """`folder` is for what is generated."""
        self.schema = project / "build.yaml"
        self.design: RtlDesign = load_rtl_design(self.schema, folder / "tree")
        system = self.design.system
        self.regions = {one.name: one.region.name for one in system.implementations}
        self._database = Database.open(system.project.part)
        self._wires = Wires(self._database)
        self._places = {name: Place.of(one) for name, one in layouts(system, self._database).items()}
        device = device_by_name(system.device)
        assert device is not None
        self._memory = FrameMemory(device)
        self._whole, self._partial = streams_of(collected(self.schema), system)

    def twin(self, name: str, *others: str) -> Twin:
        """A module as its bitstream leaves it on the device, after the full one and those of other modules."""
        return self.twin_in(self.regions[name], name, *(self._partial[one] for one in (*others, name)))

    def twin_in(self, region: str, name: str, *streams: bytes) -> Twin:
        """A module as these bitstreams leave it in a region, after the full one."""
        for stream in (*self._whole, *streams):
            self._memory.load(stream)
        place = replace(self._places[region], module=self._places[self.regions[name]].module)  # as its Verilog has it
        sources = self.design.modules[self.regions[name], name].sources
        features = decode(self._database, self._memory.frames).features
        netlist = extract(self._database, self._wires, features, place.boundary)
        return Twin(name, netlist, place, tuple(map(Path, sources)), self._tied(features, place))

    def _tied(self, features: frozenset[Feature], place: Place) -> dict[str, bool]:
        entering = {signal: at for at, signal in place.boundary.inputs.items()}
        found = extract(self._database, self._wires, features, Boundary(place.boundary.inputs, entering))
        fixed = {cell.output: bool(cell.init) for cell in found.cells if isinstance(cell, Lut) and not cell.inputs}
        return {signal: fixed[net] for signal, net in found.outputs.items() if net in fixed}


def compare(folder: Path, twins: Sequence[Twin], cycles: int, first: int = 0) -> dict[str, Compared]:
    """Run all at once in Verilator; differences count from cycle `first` on."""
    sources: dict[str, Path] = {}
    for twin in twins:
        (folder / f"bits_{twin.name}.v").write_text(
            verilog(twin.netlist, f"bits_{twin.name}", twin.place.ports, dict.fromkeys(range(12), twin.place.clock))
        )
        (folder / f"twin_{twin.name}.v").write_text(_bench(twin, first))
        sources |= {path.name: path for path in _renamed(twin, folder)}
        sources |= {f"{kind}_{twin.name}": folder / f"{kind}_{twin.name}.v" for kind in ("bits", "twin")}
    names = [twin.name for twin in twins]
    (folder / "twins.v").write_text(_top(names))
    shown = "".join(f'    printf("{name} %u %u\\n", top.wrong_{name}, top.changes_{name});\n' for name in names)
    (folder / "main.cpp").write_text(_MAIN.replace("@CYCLES@", str(cycles)).replace("@PRINT@", shown))
    files = [str(folder / "twins.v"), str(folder / "main.cpp"), *map(str, sources.values())]
    command = ["verilator", "--cc", "--exe", "--build", "-j", "2", "-Wno-fatal", "-Wno-lint", "--top-module", "twins"]
    options = ["-O3", "--x-initial", "0", "-CFLAGS", "-O1", "--Mdir", str(folder / "v")]
    done = subprocess.run([*command, *options, *files], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said = subprocess.run([folder / "v/Vtwins"], check=True, capture_output=True, text=True).stdout.splitlines()
    return {name: Compared(int(wrong), int(changes)) for name, wrong, changes in map(str.split, said)}


def _renamed(twin: Twin, folder: Path) -> Iterator[Path]:
    """Its sources, the top under a name of its own: all modules of a region have the same."""
    own = folder / f"rtl_{twin.name}"
    own.mkdir(exist_ok=True)
    for path in twin.sources:
        text = path.read_text()
        changed = re.sub(rf"\bmodule {twin.place.module}\b", f"module rtl_{twin.name}", text)
        if changed == text:
            yield path
        else:
            (own / f"rtl_{twin.name}.v").write_text(changed)
            yield own / f"rtl_{twin.name}.v"


def _top(names: Sequence[str]) -> str:
    ports = [f"output wire [31:0] {what}_{name}" for name in names for what in ("wrong", "changes")]
    cells = [
        f"    twin_{name} pair_{name} (.clk(clk), .begun(begun), .wrong(wrong_{name}), .changes(changes_{name}));"
        for name in names
    ]
    head = ["module twins (input wire clk, input wire begun,", ",\n".join(ports), ");"]
    return "\n".join([*head, *cells, "endmodule\n"])


def _bench(twin: Twin, first: int) -> str:
    """Both sides with the same inputs, their outputs compared."""
    clock, ports = twin.place.clock, twin.place.ports
    wires, pins, at = [], {1: [f".{clock}(clk)"], 2: [f".{clock}(clk)"]}, 3
    for port in (port for port in ports if port.into and port.name != clock):
        bits = [f"noise[{(at + 7 * bit) % 115}]" for bit in range(port.width)]
        if port.name == "aresetn":
            bits = ["resetn"]
        elif port.name.endswith("tlast"):
            bits = ["&noise[58:50]"]
        else:
            at += 11
        for bit in range(port.width):
            value = twin.tied.get(port.name if port.width == 1 else f"{port.name}[{bit}]")
            bits[bit] = bits[bit] if value is None else f"1'b{value:d}"
        wires.append(f"    wire [{port.width - 1}:0] {port.name} = {{{', '.join(reversed(bits))}}};")
        for side in pins.values():
            side.append(f".{port.name}({port.name})")
    outputs: list[Port] = [port for port in ports if not port.into]
    for port in outputs:
        for number, side in pins.items():
            wires.append(f"    wire [{port.width - 1}:0] {port.name}_{number};")
            side.append(f".{port.name}({port.name}_{number})")
    seen = {number: ", ".join(f"{port.name}_{number}" for port in outputs) for number in pins}
    parts = {
        "NAME": twin.name,
        "WIRES": "\n".join(wires),
        "RTL": ", ".join(pins[1]),
        "BITS": ", ".join(pins[2]),
        "HIGH": str(sum(port.width for port in outputs) - 1),
        "ONE": seen[1],
        "TWO": seen[2],
        "FIRST": str(first),
    }
    text = _TWIN
    for mark, value in parts.items():
        text = text.replace(f"@{mark}@", value)
    return text
