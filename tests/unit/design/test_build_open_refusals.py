# SPDX-License-Identifier: Apache-2.0
"""What the open tools cannot do is reported before they run, with the key in the build schema and a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import AXIL_MODULE, project
from test_build_plan import MASTER

from cm.design.generate.generation import load_design
from cm.design.openflow.rules import check_open

PLAIN = """\
project: {name: small, board: zybo-z7-20}
clocks: {fclk0: {rate: 50_000_000}, fclk1: {rate: 100_000_000}}
regions:
  left: {pblock: [SLICE_X26Y50:SLICE_X31Y99], clock: fclk0, loader: fpga_manager}
  right: {pblock: [SLICE_X36Y50:SLICE_X41Y99], clock: fclk0, loader: fpga_manager}
modules:
  one: {sources: [one.v], regions: [left]}
  two: {sources: [one.v], top: one, regions: [right]}
"""
_OF_BURSTS = """\
    input  wire [7:0]  s_axi_awlen,
    input  wire [2:0]  s_axi_awsize,
    input  wire [1:0]  s_axi_awburst,
    input  wire        s_axi_wlast,
    output wire        s_axi_rlast,
    input  wire [7:0]  s_axi_arlen,
    input  wire [2:0]  s_axi_arsize,
    input  wire [1:0]  s_axi_arburst,
    input  wire        s_axi_awvalid,
"""
BURSTS = AXIL_MODULE.replace("[7:0]  s_axi_a", "[15:0] s_axi_a").replace(
    "    input  wire        s_axi_awvalid,\n", _OF_BURSTS
)
TWO_CLOCKS = """\
module one (
    input  wire       aclk,
    input  wire       aresetn,
    input  wire       fast_clk,
    input  wire [7:0] s_axis_tdata,
    input  wire       s_axis_tvalid,
    output wire       s_axis_tready
);
endmodule
"""


def told(folder: Path, text: str, module: str) -> str:
    for name, source in (("mine.vhd", ""), ("mine.tcl", ""), ("mine.xci", "{}")):
        (folder / name).write_text(source)
    path = project(folder, text, one=module)
    return "\n".join(finding.text(path) for finding in check_open(load_design(path).system))


def test_two_regions_on_one_clock_are_accepted(tmp_path: Path) -> None:
    assert told(tmp_path, PLAIN, AXIL_MODULE) == ""


LEFT, SOURCES = "clock: fclk0, loader: fpga_manager}\n  right", "sources: [one.v], regions: [left]"
FAST = "clock: fclk0, clocks: {fast_clk: fclk1}, loader: fpga_manager}\n  right"
SECOND = ("SLICE_X41Y99], clock: fclk0", "SLICE_X41Y99], clock: fclk1")
NO_REGISTERS = TWO_CLOCKS.replace("    input  wire       fast_clk,\n", "")
CASES = {  # the change to PLAIN; the module; the message
    "a second clock": (SECOND, AXIL_MODULE, "regions.right.clock: fclk1 beside fclk0"),
    "a second clock without registers": (SECOND, NO_REGISTERS, "regions.right.clock: fclk1 beside fclk0"),
    "two clocks of one region": ((LEFT, FAST), TWO_CLOCKS, "regions.left.clocks: 2 clocks at the boundary"),
    "a master to memory": (("", ""), MASTER, "regions.left.interfaces.m_axi: a master to memory"),
    "bursts of registers": (("", ""), BURSTS, "regions.left.interfaces: an AXI4 slave of bursts"),
    "VHDL of a module": ((SOURCES, SOURCES.replace("one.v", "one.v, mine.vhd")), AXIL_MODULE, "modules.one: VHDL"),
    "VHDL of the static part": (("modules:", "static: {sources: [mine.vhd]}\nmodules:"), AXIL_MODULE, "static: VHDL"),
    "a block design": (
        ("modules:", "static: {block_design: [mine.tcl]}\nmodules:"),
        AXIL_MODULE,
        "static.block_design:",
    ),
    "IP of the vendor": ((SOURCES, f"{SOURCES}, ip: [mine.xci]"), AXIL_MODULE, "modules.one: vendor IP"),
    "no pblock": (
        ("[SLICE_X26Y50:SLICE_X31Y99]", "auto"),
        AXIL_MODULE,
        "regions.left.pblock: the open flow wants ranges",
    ),
    "another family": (
        ("board: zybo-z7-20", "part: xck26-sfvc784-2LV-c"),
        AXIL_MODULE,
        "project: xck26: nextpnr has no",
    ),
    "the ICAP": ((LEFT, LEFT.replace("fpga_manager", "icap")), AXIL_MODULE, "regions: ICAPE2"),
}


@pytest.mark.parametrize("case", CASES)
def test_each_refusal_names_its_key_and_what_to_do(tmp_path: Path, case: str) -> None:
    (old, new), module, wanted = CASES[case]
    assert old in PLAIN
    text = told(tmp_path, PLAIN.replace(old, new, 1), module)
    assert wanted in text
    assert "(" in text.partition(wanted)[2]  # what to do about it
