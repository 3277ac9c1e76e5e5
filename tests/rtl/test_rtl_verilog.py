# SPDX-License-Identifier: Apache-2.0
"""Modules in Verilog behind the simulated nodes: what is a name there, whatever SystemVerilog reserves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from build_support import MINIMAL, project
from conftest import needs
from headless_rig import running

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]
# module, port, instance and signals are named by words that SystemVerilog has taken since
RESERVED = """\
module %NAME% (
    input  wire        clk, resetn,
    input  wire [31:0] s_axis_tdata, input wire s_axis_tvalid, s_axis_tlast, output wire s_axis_tready,
    output wire [31:0] m_axis_tdata, output wire m_axis_tvalid, m_axis_tlast, input wire m_axis_tready
);
    wire [31:0] bit, bins, ref, int;
    reg do;
    always @(posedge clk) do <= resetn;
    assign bit = s_axis_tdata, bins = bit, ref = bins, int = ~ref;
    assign s_axis_tready = m_axis_tready && do;
    assign m_axis_tvalid = s_axis_tvalid && do;
    assign m_axis_tlast = s_axis_tlast;
    priority unique (.logic(int), .byte(m_axis_tdata));
endmodule

module priority (input wire [31:0] logic, output wire [31:0] byte);
    assign byte = logic;
endmodule
"""


@pytest.mark.parametrize("name", ["cross", "checker", "interface", "program"])
def test_words_that_systemverilog_reserves_are_names_in_a_verilog_module(tmp_path: Path, name: str) -> None:
    schema = project(tmp_path, f"{MINIMAL}    top: {name}\n", one=RESERVED.replace("%NAME%", name))
    data = np.arange(64, dtype=np.uint32)
    with running(schema, tmp_path) as board:
        board.load("one")
        assert np.array_equal(board.picture(data, data.nbytes).view(np.uint32), ~data)
