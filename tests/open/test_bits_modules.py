# SPDX-License-Identifier: Apache-2.0
"""The modules of the open flow by their bits against their own Verilog, for a million cycles each."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from cm.bits import Port, verilog
from cm.bits.cells import Dsp
from cm.bits.files import collected, streams_of
from cm.bits.regions import LoadedBits, Place
from cm.build.openflow.layout import layouts
from cm.rtl.compile import NOTHING
from cm.rtl.design import load_rtl_design
from cm.rtl.tools import find_tools
from cm.xray import Database

pytestmark = pytest.mark.timeout(900)
CYCLES = 1_000_000
# Random beats and accesses, seldom a reset; TLAST about once in a line.
_TOP = """
module both (input wire clk, output reg wrong, output wire [31:0] seen);
    reg [127:0] noise = 128'h0123456789abcdef_fedcba9876543210;
    reg [31:0] cycle = 0;
    wire resetn = cycle > 20 && noise[127:116] != 12'd0;
    always @(posedge clk) begin
        cycle <= cycle + 1;
        noise <= {noise[126:0], noise[127] ^ noise[125] ^ noise[100] ^ noise[98]};
        wrong <= cycle > 40 && {@ONE@} != {@TWO@};
    end
@WIRES@
    @MODULE@ rtl (@RTL@);
    bits frames (@BITS@);
    assign seen = {s_axi_rdata_1[15:0], m_axis_tvalid_1, m_axis_tdata_1[7:0], s_axi_rvalid_1, 6'd0};
endmodule
"""
_MAIN = """
#include "Vboth.h"
#include <cstdio>
int main() {
    Vboth top;
    long wrong = 0, changes = 0;
    unsigned before = 0;
    for (long cycle = 0; cycle < @CYCLES@; cycle++) {
        top.clk = 1; top.eval();
        wrong += top.wrong;
        changes += top.seen != before;
        before = top.seen;
        top.clk = 0; top.eval();
    }
    printf("%ld wrong, %ld changes\\n", wrong, changes);
}
"""


def bench(ports: tuple[Port, ...], clock: str, module: str) -> str:
    """Both sides with the same inputs, their outputs compared."""
    wires, pins, at = [], {1: [f".{clock}(clk)"], 2: [f".{clock}(clk)"]}, 3
    inputs = [port for port in ports if port.into and port.name != clock]
    for port in inputs:
        if port.name == "aresetn":
            value = "resetn"
        elif port.name.endswith("tlast"):
            value = "&noise[58:50]"
        else:
            value = "{" + ", ".join(f"noise[{(at + 7 * bit) % 115}]" for bit in range(port.width)) + "}"
            at += 11
        wires.append(f"    wire [{port.width - 1}:0] {port.name} = {value};")
        for side in pins.values():
            side.append(f".{port.name}({port.name})")
    outputs = [port for port in ports if not port.into]
    for port in outputs:
        for number, side in pins.items():
            wires.append(f"    wire [{port.width - 1}:0] {port.name}_{number};")
            side.append(f".{port.name}({port.name}_{number})")
    text = _TOP.replace("@WIRES@", "\n".join(wires))
    for number, mark in ((1, "@ONE@"), (2, "@TWO@")):
        text = text.replace(mark, ", ".join(f"{port.name}_{number}" for port in outputs))
    return text.replace("@MODULE@", module).replace("@RTL@", ", ".join(pins[1])).replace("@BITS@", ", ".join(pins[2]))


@pytest.mark.parametrize(
    ("fixture", "region", "name"),
    [
        ("open_project", "prr0", "default"),
        ("open_project", "prr0", "edge"),
        ("open_project", "prr0", "colorise"),
        ("open_pair", "right", "colour_right"),
    ],
)
def test_a_million_cycles_of_a_modules_bits_equal_those_of_its_verilog(
    request: pytest.FixtureRequest, tmp_path: Path, fixture: str, region: str, name: str
) -> None:
    schema = request.getfixturevalue(fixture) / "build.yaml"
    design = load_rtl_design(schema, tmp_path / "tree")
    bits = LoadedBits.of(design.system, find_tools(), NOTHING, tmp_path)
    whole, partial = streams_of(collected(schema), design.system)
    for stream in (*whole, partial[name]):
        bits.take(memoryview(stream))
    netlist = bits.netlist(region)
    assert not netlist.notes
    assert any(isinstance(cell, Dsp) for cell in netlist.cells) == (name == "colour_right")
    place = Place.of(layouts(design.system, Database.open(design.system.project.part))[region])
    (tmp_path / "bits.v").write_text(verilog(netlist, "bits", place.ports, {0: place.clock}))
    (tmp_path / "both.v").write_text(bench(place.ports, place.clock, place.module))
    (tmp_path / "main.cpp").write_text(_MAIN.replace("@CYCLES@", str(CYCLES)))
    files = [str(tmp_path / file) for file in ("both.v", "bits.v", "main.cpp")]
    files += map(str, design.modules[region, name].sources)
    command = ["verilator", "--cc", "--exe", "--build", "-O3", "-Wno-fatal", "-Wno-lint", "--top-module", "both"]
    subprocess.run([*command, "--Mdir", str(tmp_path / "v"), *files], check=True, capture_output=True)
    said = subprocess.run([tmp_path / "v/Vboth"], check=True, capture_output=True, text=True).stdout.split()
    assert said[0] == "0"
    assert int(said[2]) > CYCLES // 4
