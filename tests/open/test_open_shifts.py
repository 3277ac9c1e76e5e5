# SPDX-License-Identifier: Apache-2.0
"""Shift registers after synthesis, beside their Verilog in Icarus."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from cm.design.openflow.synth import Sources, script
from cm.design.openflow.tools import Tools

MODULE = """\
module shifts (input clk, input ce, input in, input [3:0] tap, output enabled, output always_, output variable);
    reg [5:0] one = 6'h2a;
    always @(posedge clk) if (ce) one <= {one, in};
    assign enabled = one[5];
    reg [9:0] two = 10'h155;
    always @(posedge clk) two <= {two, in};
    assign always_ = two[9];
    reg [15:0] three = 16'h1234;
    always @(posedge clk) if (ce) three <= {three, in};
    assign variable = three[tap];
endmodule
"""
BENCH = """\
module bench;
    reg clk = 0;
    reg [15:0] noise = 1;
    integer wrong = 0, enabled = 0;
    wire [2:0] one, two;
    wire ce = noise[3] ^ noise[7];
    shifts cells (clk, ce, noise[0], noise[12:9], one[0], one[1], one[2]);
    written verilog (clk, ce, noise[0], noise[12:9], two[0], two[1], two[2]);
    initial begin
        #1;
        repeat (2000) begin
            if (one !== two) wrong = wrong + 1;
            if (ce) enabled = enabled + 1;
            #1 clk = 1;
            #1 clk = 0;
            noise = {noise[14:0], noise[15] ^ noise[13] ^ noise[12] ^ noise[10]};
        end
        $display("%0d wrong, %0d enabled", wrong, enabled);
    end
endmodule
"""


def test_a_shift_register_with_an_enable_shifts_only_where_it_is_enabled(tools: Tools, tmp_path: Path) -> None:
    """YosysHQ/yosys issue 6058: those of a fixed length shifted in every cycle."""
    verilog, bench, netlist = (tmp_path / name for name in ("shifts.v", "bench.v", "netlist.v"))
    verilog.write_text(MODULE)
    bench.write_text(MODULE.replace("module shifts", "module written") + BENCH)
    commands = script(Sources("shifts", (verilog,)), tmp_path / "netlist.json", tmp_path)
    (tmp_path / "commands.ys").write_text(f"{commands}write_verilog -noattr netlist.v\n")
    yosys = tools.yosys
    environment = {**os.environ, **dict(yosys.environment)}
    subprocess.run([*yosys.command, "-q", "-s", "commands.ys"], cwd=tmp_path, env=environment, check=True)
    kinds = re.findall(r"^  (SRL\w+|FDRE) ", netlist.read_text(), re.MULTILINE)
    assert {kind: kinds.count(kind) for kind in kinds} == {"SRL16E": 2, "FDRE": 6}
    library = next(Path(tools.database).parents[1].rglob("xilinx/cells_sim.v"), None)
    if library is None:
        pytest.skip("needs yosys' models of cells, which are not beside the tools")
    run = ["iverilog", "-g2012", "-s", "bench", "-o", "run", str(bench), str(netlist), str(library)]
    subprocess.run(run, cwd=tmp_path, check=True)
    said = subprocess.run(["vvp", "-n", "run"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    wrong, enabled = map(int, re.findall(r"\d+", said))
    assert wrong == 0
    assert 500 < enabled < 1500
