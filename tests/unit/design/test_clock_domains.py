# SPDX-License-Identifier: Apache-2.0
"""Which clock a reset belongs to: by attribute, by names, by the build schema, and never by guess."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from build_support import MINIMAL, STREAM_MODULE, project
from hdl_support import ports

from cm.cli.main import main
from cm.design.boundary.analyse import analyse
from cm.design.boundary.make import boundary
from cm.design.hdl.model import Polarity
from cm.design.project.load import load_project

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

# clocks and resets of a module → the clock of each reset; ? where only a person knows
PAIRS = [
    ("core_clk core_rst_n aclk aresetn", "core_rst_n-core_clk aresetn-aclk"),
    ("aclk aresetn core_aclk core_aresetn", "core_aresetn-core_aclk aresetn-aclk"),
    ("aclk aresetn clk_core rst_core_n", "rst_core_n-clk_core aresetn-aclk"),
    ("aclk aresetn pix_clk pix_rst", "pix_rst+pix_clk aresetn-aclk"),
    ("clk rst clk_pixel reset_pixel_l", "rst+clk reset_pixel_l-clk_pixel"),
    ("aclk aresetn pixclk pixrst", "aresetn-aclk pixrst+pixclk"),
    ("clk_a clk_b rst_a rst_b", "rst_a+clk_a rst_b+clk_b"),
    ("clk rst_b", "rst_b-clk"),
    ("clk clk_b rst rst_b", "rst+clk rst_b+clk_b"),
    ("clk1 clk2 rst1_n rst2_n", "rst1_n-clk1 rst2_n-clk2"),
    ("clk clk2x rst_n", "rst_n-clk"),
    ("clk clk_fu clk_full rst rst_fu_l rst_full", "rst+clk rst_fu_l-clk_fu rst_full+clk_full"),
    ("clk_in clk_out rst_in rst_out", "rst_in+clk_in rst_out+clk_out"),
    ("i_clk i_reset_n i_aux_clk", "i_reset_n-i_clk"),
    ("i_wclk i_wr_reset_n i_rclk i_rd_reset_n", "i_wr_reset_n-i_wclk i_rd_reset_n-i_rclk"),
    ("clk_i rst_ni clk_io_i rst_io_ni", "rst_ni-clk_i rst_io_ni-clk_io_i"),
    ("clk125mhz rst125mhz clk", "rst125mhz+clk125mhz"),
    ("pclk presetn aclk aresetn", "presetn-pclk aresetn-aclk"),
    ("logic_clk logic_rst gmii_rx_clk rx_rst", "logic_rst+logic_clk rx_rst+gmii_rx_clk"),
    ("mclk clk pixclk_rst", "pixclk_rst?"),
    ("wr_clk rd_clk rst", "rst?"),
    ("aclk pixel_clock video_rst aresetn", "video_rst? aresetn-aclk"),
    ("clk core_rst", "core_rst+clk"),
]


@pytest.mark.parametrize(("names", "wanted"), PAIRS)
def test_a_reset_belongs_to_the_clock_of_its_name_or_is_asked_for(names: str, wanted: str, tmp_path: Path) -> None:
    found = ports(tmp_path, "; ".join(f"input {name}" for name in names.split()))
    signs = {Polarity.LOW: "-", Polarity.HIGH: "+"}
    text = " ".join(f"{r.port}{signs[r.polarity]}{r.clock}" if r.clock else f"{r.port}?" for r in found.resets)
    assert sorted(text.split()) == sorted(wanted.split())
    assert all(reset.why if reset.clock else len(reset.may_be) > 1 for reset in found.resets)
    assert len([p for p in found.problems if "may belong to any of" in p.message]) == wanted.count("?")


def test_the_wrapper_connects_each_reset_to_that_of_its_own_clock(tmp_path: Path) -> None:
    found = ports(tmp_path, "input aclk; input aresetn; input core_clk; input core_rst_n; input pix_clk; input pix_rst")
    made = boundary({"m": found}).adaptations[0]
    assert made.ok
    assert {c.module: c.boundary for c in made.connections if c.module.endswith(("n", "rst"))} == {
        "aresetn": "aresetn", "core_rst_n": "core_clk_resetn", "pix_rst": "pix_clk_resetn",
    }  # fmt: skip


def test_associated_reset_goes_before_names_and_may_name_several(tmp_path: Path) -> None:
    said = '(* X_INTERFACE_PARAMETER = "ASSOCIATED_RESET b_rst:extra_rst" *) input a_clk; input b_clk; input b_rst'
    found = ports(tmp_path, f"{said}; input extra_rst; input a_rst")
    assert {r.port: (r.clock, r.why) for r in found.resets} == {
        "b_rst": ("a_clk", "stated"), "extra_rst": ("a_clk", "stated"), "a_rst": ("a_clk", "both are named a"),
    }  # fmt: skip


def decided(folder: Path, keys: str) -> Path:
    text = STREAM_MODULE.format(name="one", high=31)
    first = text.index("(") + 1
    text = f"{text[:first]}\n    input wire wr_clk, input wire rd_clk, input wire video_rst,{text[first:]}"
    return project(folder, MINIMAL + keys, one=text)


def test_an_undecided_reset_stops_check_with_the_line_that_decides_it(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = decided(tmp_path, "")
    assert main(["build", "check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "one.v:2: video_rst is a reset that may belong to any of the clocks" in said
    assert "write resets: {video_rst: {clock: " in said
    assert main(["build", "generate", str(path)]) == 1


def test_the_build_schema_decides_clock_and_polarity(tmp_path: Path) -> None:
    path = decided(tmp_path, "    resets: {video_rst: {clock: rd_clk, polarity: low}}\n")
    found = analyse(load_project(path)).modules["one"]
    (reset,) = [reset for reset in found.resets if reset.port == "video_rst"]
    assert (reset.clock, reset.polarity, reset.why) == ("rd_clk", Polarity.LOW, "stated")


def test_the_build_schema_says_what_runs_on_a_clock(tmp_path: Path) -> None:
    path = decided(tmp_path, "    clocks: {wr_clk: {interfaces: [s_axis]}}\n    resets: {video_rst: {clock: rd_clk}}\n")
    found = analyse(load_project(path)).modules["one"]
    assert (found.interface("s_axis").clock, found.interface("m_axis").clock) == ("wr_clk", "clk")


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            "clocks: {rd_clx: {interfaces: [s_axis]}}",
            "build.yaml:7:14: modules.one.clocks.rd_clx: one has no port rd_clx (did you mean rd_clk?)",
        ),
        ("resets: {rts: {clock: rd_clk}}", "build.yaml:7:14: modules.one.resets.rts: one has no port rts"),
        ("resets: {video_rst: {clock: rd_clock}}", "modules.one.resets.video_rst: one has no clock rd_clock"),
        (
            "clocks: {rd_clk: {interfaces: [axis]}}",
            "build.yaml:7:14: modules.one.clocks.rd_clk: one has no interface axis",
        ),
        ("parameters: {DEPTH: 1}", "build.yaml:7:18: modules.one.parameters.DEPTH: "),
        ("resets: {video_rst: {polarity: down}}", "build.yaml:7:26: modules.one.resets.video_rst.polarity"),
    ],
)
def test_what_the_module_does_not_have_is_refused_at_its_line(
    keys: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert main(["build", "check", str(decided(tmp_path, f"    {keys}\n"))]) == 1
    assert said in capsys.readouterr().err


def test_interfaces_shows_what_was_decided_and_why(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    file = tmp_path / "m.v"
    names = ("clk", "rst", "clk_pixel", "reset_pixel_l", "video_rst")
    file.write_text(f"module m ({', '.join(f'input {name}' for name in names)}); endmodule\n")
    assert main(["build", "interfaces", str(file)]) == 0
    said = capsys.readouterr().out
    assert "reset_pixel_l, active low, of clk_pixel: both are named pix" in said
    assert "video_rst, active high, of any of clk, clk_pixel: not decided" in said
    assert main(["build", "interfaces", "--json", str(file)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [(reset["port"], reset["clock"], reset["may_be"]) for reset in found["resets"]] == [
        ("rst", "clk", []), ("reset_pixel_l", "clk_pixel", []), ("video_rst", None, ["clk", "clk_pixel"]),
    ]  # fmt: skip
    assert {clock["port"]: clock["reset"] for clock in found["clocks"]} == {"clk": "rst", "clk_pixel": "reset_pixel_l"}
