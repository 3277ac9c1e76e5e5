# SPDX-License-Identifier: Apache-2.0
"""A region whose streams run on two clocks: each with its decoupler, its reset and its DMA engine on its own."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import HERE, needs
from headless_rig import running

from cm.design.generate.generation import generate, load_design

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(600)]
SCHEMA = """\
project: {name: crossing, part: xc7z020clg400-1}
clocks: {fclk0: {rate: 100_000_000}, fclk1: {rate: %d}}
regions:
  prr0: {clocks: {clk: fclk0, pix_clk: fclk1}, interfaces: {s_axis: {shape: [64]}, m_axis: {shape: [64]}}}
modules:
  handed: {sources: [handed.v], clocks: {clk: {interfaces: [s_axis]}, pix_clk: {interfaces: [m_axis]}}}
"""
# a beat at a time, handed over by a level that changes
HANDED = """\
module handed (
    input  wire clk, input wire resetn, input wire pix_clk, input wire pix_rst_n,
    input  wire [31:0] s_axis_tdata, input wire s_axis_tvalid, output wire s_axis_tready, input wire s_axis_tlast,
    output reg  [31:0] m_axis_tdata, output reg m_axis_tvalid, input wire m_axis_tready, output reg m_axis_tlast
);
    reg [32:0] held;
    reg asked, given;
    reg [1:0] asked_there, given_here;
    assign s_axis_tready = resetn && asked == given_here[1];
    always @(posedge clk) begin
        given_here <= {given_here[0], given};
        if (!resetn) begin asked <= 1'b0; given_here <= 2'b00; end
        else if (s_axis_tvalid && s_axis_tready) begin held <= {s_axis_tlast, s_axis_tdata}; asked <= !asked; end
    end
    always @(posedge pix_clk) begin
        asked_there <= {asked_there[0], asked};
        if (!pix_rst_n) begin given <= 1'b0; m_axis_tvalid <= 1'b0; asked_there <= 2'b00; end
        else if (m_axis_tvalid) begin if (m_axis_tready) begin m_axis_tvalid <= 1'b0; given <= asked_there[1]; end end
        else if (asked_there[1] != given) begin
            {m_axis_tlast, m_axis_tdata} <= ~held ^ {1'b1, 32'd0};
            m_axis_tvalid <= 1'b1;
        end
    end
endmodule
"""


def begun(folder: Path, rate: int) -> Path:
    (folder / "handed.v").write_text(HANDED)
    (folder / "build.yaml").write_text(SCHEMA % rate)
    return folder / "build.yaml"


@pytest.mark.parametrize("rate", [50_000_000, 76_923_076, 142_857_141])
def test_what_goes_in_on_one_clock_comes_out_on_the_other(rate: int, tmp_path: Path) -> None:
    picture = np.random.default_rng(rate).integers(0, 256, 64, dtype=np.uint8)
    with running(begun(tmp_path, rate), tmp_path) as run:
        for _ in range(3):  # loaded again: cut off, reset and joined on both clocks
            run.load("handed")
            assert (run.picture(picture, 64) == ~picture).all()


def test_the_static_part_is_clean_and_each_end_is_on_its_clock(tmp_path: Path) -> None:
    design = load_design(begun(tmp_path, 50_000_000))
    generate(design, tmp_path / "build")
    hdl = tmp_path / "build/hdl"
    words = ["--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v"]
    done = subprocess.run(["verilator", "--lint-only", "-Wall", *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert {dma.name: dma.clock for dma in design.system.dmas if dma.name != "icap"} == {
        "prr0_s_axis": "fclk0", "prr0_m_axis": "fclk1",
    }  # fmt: skip
    script = (tmp_path / "build/tcl/block_design.tcl").read_text()
    assert "rate_fclk1" in script
