# SPDX-License-Identifier: Apache-2.0
"""What `cm build init` writes is good, or init says what it cannot know; files are in an order that tools take."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from build_support import AXIL_MODULE, STREAM_MODULE
from hdl_support import DATA
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cm.cli.main import main
from cm.design.compile_order import compile_order

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
pytest.importorskip("jinja2", reason="needs jinja2: the extra [build] is not installed")


def good_or_told(folder: Path, capsys: pytest.CaptureFixture, *files: Path) -> list[str]:
    """What init did not know; if nothing, check and generate have passed."""
    build = folder / "build.yaml"
    build.unlink(missing_ok=True)
    capsys.readouterr()
    if main(["build", "init", *map(str, files), "-o", str(build)]) != 0:
        return [capsys.readouterr().err]
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("not known: ")]
    if not told:
        assert main(["build", "check", str(build)]) == 0
        assert main(["build", "generate", str(build)]) == 0
    return told


@pytest.mark.parametrize(
    "path", sorted(p for p in DATA.glob("*") if p.suffix in (".v", ".sv", ".vhd")), ids=lambda p: p.name
)
def test_every_file_of_the_collection_is_begun_well_or_init_says_why(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    good_or_told(tmp_path, capsys, path)


CLOCKS = ("clk", "aclk", "pix_clk", "core_clk", "wr_clk")
RESETS = ("rst", "aresetn", "pix_rst", "core_rst_n", "video_rst")


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.sampled_from(CLOCKS), min_size=1, unique=True), st.lists(st.sampled_from(RESETS), unique=True))
def test_any_clocks_and_resets_are_begun_well_or_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture, clocks: list[str], resets: list[str]
) -> None:
    ports = ", ".join(f"input wire {name}" for name in (*clocks, *resets))
    text = STREAM_MODULE.format(name="one", high=31)
    text = text.replace("    input  wire        clk,\n    input  wire        resetn,\n", f"    {ports},\n")
    (tmp_path / "one.v").write_text(text)
    for sentence in good_or_told(tmp_path, capsys, tmp_path / "one.v"):
        assert "resets: {" in sentence or "clocks: {" in sentence or "do not fit" in sentence, sentence


def test_two_clocks_are_begun_with_a_line_for_the_second(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    text = STREAM_MODULE.format(name="one", high=31).replace(
        "(\n", "(\n    input wire pix_clk, input wire pix_rst,\n", 1
    )
    (tmp_path / "one.v").write_text(text)
    assert good_or_told(tmp_path, capsys, tmp_path / "one.v") == []
    assert "pix_clk" in yaml.safe_load((tmp_path / "build.yaml").read_text())["regions"]["prr0"]["clocks"]


def test_packages_come_before_their_users_and_the_rest_stays(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "a_top.sv").write_text(
        STREAM_MODULE.format(name="top", high=31).replace("module top", "module top import z_pkg::*;")
    )
    (tmp_path / "b_base.sv").write_text("package b_base; typedef logic [7:0] byte_t; endpackage\n")
    (tmp_path / "c.sv").write_text("// package c; is a comment: z_pkg::x\nmodule c; endmodule\n")
    (tmp_path / "z_pkg.sv").write_text("package z_pkg; import b_base::*; typedef byte_t word_t; endpackage\n")
    files = sorted(tmp_path.glob("*.sv"))
    assert [path.stem for path in compile_order(files)] == ["b_base", "z_pkg", "a_top", "c"]
    assert good_or_told(tmp_path, capsys, *files) == []
    module = yaml.safe_load((tmp_path / "build.yaml").read_text())["modules"]["top"]
    assert module["sources"] == ["b_base.sv", "z_pkg.sv", "a_top.sv"]
    script = (tmp_path / "build/tcl/step_synth_top.tcl").read_text()
    assert script.index("z_pkg.sv") < script.index("a_top.sv")


def test_what_vhdl_refers_to_comes_before_it(tmp_path: Path) -> None:
    (tmp_path / "a_top.vhd").write_text(
        "-- entity work.e_sub is a comment\nlibrary work; use work.Z_types.all;\nentity a_top is end a_top;\n"
        "architecture x of a_top is begin u: entity work.d_part(fast) port map (a => '0'); end x;\n"
    )
    (tmp_path / "b_body.vhd").write_text("package body z_types is end package body;\n")
    (tmp_path / "c_fast.vhdl").write_text("architecture fast of D_Part is begin end fast;\n")
    (tmp_path / "d_part.vhd").write_text("entity D_PART is port (a : in bit); end;\n")
    (tmp_path / "e_sub.vhd").write_text("entity e_sub is end;\n")
    (tmp_path / "z_types.vhd").write_text("package z_types is end package;\n")
    files = sorted(tmp_path.iterdir())
    order = ["z_types", "d_part", "a_top", "b_body", "c_fast", "e_sub"]
    assert [path.stem for path in compile_order(files)] == order


def test_packages_that_use_each_other_stay_as_they_are(tmp_path: Path) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.sv").write_text(f"package {name}; import {other}::*; endpackage\n")
    assert len(compile_order(sorted(tmp_path.glob("*.sv")))) == 2


def test_two_exports_with_copies_of_what_they_share_each_get_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    for name, module in (
        ("one", STREAM_MODULE.format(name="one", high=31)),
        ("two", AXIL_MODULE.replace(" one ", " two ")),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.v").write_text(module.replace("endmodule", "    shared inner ();\nendmodule"))
        (tmp_path / name / "shared.v").write_text("module shared; endmodule\n")
    assert good_or_told(tmp_path, capsys, *sorted(tmp_path.glob("*/*.v"))) == []
    modules = yaml.safe_load((tmp_path / "build.yaml").read_text())["modules"]
    assert {name: sorted(module["sources"]) for name, module in modules.items()} == {
        "one": ["one/one.v", "one/shared.v"], "two": ["two/shared.v", "two/two.v"],
    }  # fmt: skip
