# SPDX-License-Identifier: Apache-2.0
"""Streams of any width: the converter by itself for every width, and in a generated static part round trip."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from build_support import MINIMAL, project
from conftest import HERE, needs
from simulation import simulate

from cm.design.generate.generation import generate, load_design, output_folder

RTL = HERE.parent.parent / "cm" / "design" / "rtl"
WIDE = """\
module one (
    input  wire         clk,
    input  wire         resetn,
    input  wire [{high}:0] s_axis_tdata,{keep_in}
    input  wire         s_axis_tvalid,
    output wire         s_axis_tready,
    input  wire         s_axis_tlast,
    output wire [{high}:0] m_axis_tdata,{keep_out}
    output wire         m_axis_tvalid,
    input  wire         m_axis_tready,
    output wire         m_axis_tlast
);
    assign m_axis_tdata = ~s_axis_tdata;{keep_assign}
    assign m_axis_tvalid = s_axis_tvalid;
    assign s_axis_tready = m_axis_tready;
    assign m_axis_tlast = s_axis_tlast;
endmodule
"""


def run_bench(folder: Path, source: str) -> str:
    """What the bench of all widths says with this converter."""
    (folder / "cm_axis_width.v").write_text(source)
    bench = HERE / "tb" / "tb_axis_width.v"
    command = ["iverilog", "-g2005-sv", "-s", "tb_axis_width", "-o", "bench", str(bench), "cm_axis_width.v"]
    subprocess.run(command, cwd=folder, check=True)
    return subprocess.run(["vvp", "bench"], cwd=folder, capture_output=True, text=True, check=True).stdout


@needs("iverilog")
@pytest.mark.timeout(300)
def test_every_width_from_8_to_512_bits_keeps_every_byte_both_ways(tmp_path: Path) -> None:
    assert run_bench(tmp_path, (RTL / "cm_axis_width.v").read_text()) == "PASS 64 widths\n"


@needs("iverilog")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("keep", [False, True])
def test_pixels_of_24_bits_go_from_memory_through_a_region_and_back(keep: bool, tmp_path: Path) -> None:
    """As the processor's side sees it: engines of 32 bits, an independent model of the bus."""
    more = {
        "keep_in": "\n    input  wire [2:0]   s_axis_tkeep," if keep else "",
        "keep_out": "\n    output wire [2:0]   m_axis_tkeep," if keep else "",
        "keep_assign": "\n    assign m_axis_tkeep = s_axis_tkeep;" if keep else "",
    }
    design = load_design(project(tmp_path, MINIMAL, one=WIDE.format(high=23, **more)))
    out = output_folder(design.project, None)
    generate(design, out)
    sources = [out / "hdl/cm_static.v", *sorted((out / "hdl/lib").glob("*.v")), *sorted((HERE / "models").glob("*.v"))]
    sources += [out / "wrappers/one/cm_region_prr0.v", tmp_path / "one.v"]
    ran = simulate("cm_static", sources, "cocotb_pixels", tmp_path / "sim", CM_KEEP=str(int(keep)))
    assert len(ran) == 2
