# SPDX-License-Identifier: Apache-2.0
"""A first build schema from HDL files: it is correct, and the rest of the tool accepts it."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import EXAMPLES, STREAM_MODULE

from cm.cli.main import main
from cm.design.project.load import load_project

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
CAMERA = sorted((EXAMPLES / "camera/hdl").glob("*.v"))


def test_the_camera_modules_become_modules_of_one_region(tmp_path: Path) -> None:
    schema = tmp_path / "build.yaml"
    assert main(["build", "init", *map(str, CAMERA), "-o", str(schema), "--name", "my camera"]) == 0
    found = load_project(schema)
    assert found.name == "my_camera"
    assert sorted(found.modules) == ["camera_colorise", "camera_default", "camera_edge"]
    assert [path.name for path in found.modules["camera_edge"].sources] == ["camera_edge.v", "camera_registers.v"]
    assert (tmp_path / "build.schema.json").exists()


def test_a_schema_that_is_there_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    schema = tmp_path / "build.yaml"
    schema.write_text("mine\n")
    assert main(["build", "init", *map(str, CAMERA), "-o", str(schema)]) == 1
    assert schema.read_text() == "mine\n"
    assert "exists already" in capsys.readouterr().err


def test_a_module_without_a_bus_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    source = tmp_path / "plain.v"
    source.write_text("module plain (input wire a, output wire b); assign b = a; endmodule\n")
    assert main(["build", "init", str(source), "-o", str(tmp_path / "build.yaml")]) == 1
    assert "no module with a bus interface" in capsys.readouterr().err


def test_modules_that_do_not_fit_each_other_are_noted(tmp_path: Path) -> None:
    for name, high in (("narrow", 7), ("wide", 63)):
        (tmp_path / f"{name}.v").write_text(STREAM_MODULE.format(name=name, high=high))
    files = [str(tmp_path / f"{name}.v") for name in ("narrow", "wide")]
    assert main(["build", "init", *files, "-o", str(tmp_path / "build.yaml")]) == 0
    assert "does not fit one region with the others" in (tmp_path / "build.yaml").read_text()


def test_names_with_blanks_stay_whole(tmp_path: Path) -> None:
    folder = tmp_path / "my designs"
    folder.mkdir()
    (folder / "a b.v").write_text(STREAM_MODULE.format(name="one", high=31))
    assert main(["build", "init", str(folder / "a b.v"), "-o", str(tmp_path / "build.yaml")]) == 0
    assert load_project(tmp_path / "build.yaml").modules["one"].sources[0].name == "a b.v"


def test_files_of_packages_and_macros_go_with_every_module(tmp_path: Path) -> None:
    """They keep the given order, before the files that use them."""
    (tmp_path / "width.vh").write_text("`define WIDTH 16\n")
    (tmp_path / "sizes.sv").write_text("package sizes;\n    localparam int HIGH = 31;\nendpackage\n")
    text = STREAM_MODULE.format(name="one", high="sizes::HIGH").replace("input  wire        clk,", "input wire clk,")
    (tmp_path / "one.sv").write_text(text)
    (tmp_path / "two.v").write_text(STREAM_MODULE.format(name="two", high="`WIDTH*2-1"))
    files = [str(tmp_path / name) for name in ("width.vh", "sizes.sv", "one.sv", "two.v")]
    schema = tmp_path / "build.yaml"
    assert main(["build", "init", *files, "-o", str(schema)]) == 0
    sources = {name: [path.name for path in module.sources] for name, module in load_project(schema).modules.items()}
    assert sources == {"one": ["width.vh", "sizes.sv", "one.sv"], "two": ["width.vh", "sizes.sv", "two.v"]}
    assert main(["build", "check", str(schema)]) == 0


def test_a_package_of_one_language_is_no_source_of_a_module_in_the_other(tmp_path: Path) -> None:
    """`cm serve --sim=rtl` refuses modules that are in both."""
    ports = "clk: in std_logic; m_axis_tdata: out std_logic_vector(31 downto 0); m_axis_tvalid: out std_logic;"
    ports += " m_axis_tready: in std_logic; m_axis_tlast: out std_logic"
    files = {
        "sizes.sv": "package sizes;\n    localparam int HIGH = 31;\nendpackage\n",
        "words.vhd": "package words is\n    constant HIGH: integer := 31;\nend package;\n",
        "one.v": STREAM_MODULE.format(name="one", high=31),
        "two.vhd": f"library ieee; use ieee.std_logic_1164.all;\nentity two is port ({ports}); end entity;\n"
        "architecture rtl of two is begin end architecture;\n",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    schema = tmp_path / "build.yaml"
    assert main(["build", "init", *(str(tmp_path / name) for name in files), "-o", str(schema)]) == 0
    sources = {name: [path.name for path in module.sources] for name, module in load_project(schema).modules.items()}
    assert sources == {"one": ["sizes.sv", "one.v"], "two": ["words.vhd", "two.vhd"]}


def test_macros_are_defined_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    text = STREAM_MODULE.format(name="one", high="`HIGH").replace("    input  wire        clk", "`CLK")
    (tmp_path / "one.v").write_text(text)
    build = tmp_path / "build.yaml"
    files = [str(tmp_path / "one.v"), "-D", "HIGH=31", "-D", "CLK=input wire clk"]
    assert main(["build", "init", *files, "-o", str(build)]) == 0
    assert "not known" not in capsys.readouterr().out
    assert main(["build", "check", str(build)]) == 0


def test_folders_of_included_files_are_named_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "include").mkdir()
    (tmp_path / "include/width.vh").write_text("`define WIDTH 16\n")
    text = STREAM_MODULE.format(name="one", high="`WIDTH-1")
    (tmp_path / "one.v").write_text(f'`include "width.vh"\n{text}')
    schema = tmp_path / "build.yaml"
    files = [str(tmp_path / "one.v"), "-I", str(tmp_path / "include")]
    assert main(["build", "init", *files, "-o", str(schema)]) == 0
    assert "not known" not in capsys.readouterr().err
    assert load_project(schema).modules["one"].include_dirs == (tmp_path / "include",)
    assert main(["build", "check", str(schema)]) == 0


def test_the_board_that_is_proposed_has_the_part(tmp_path: Path) -> None:
    schema = tmp_path / "build.yaml"
    assert main(["build", "init", *map(str, CAMERA), "-o", str(schema), "--part", "xck26-sfvc784-2LV-c"]) == 0
    assert "# board: xilinx.com:kv260_som:part0:1.4" in schema.read_text()


def test_parameters_of_the_command_line_are_those_of_the_module(tmp_path: Path) -> None:
    text = STREAM_MODULE.format(name="one", high="BITS-1").replace("module one (", "module one #(parameter BITS = 0) (")
    (tmp_path / "one.v").write_text(text)
    schema = tmp_path / "build.yaml"
    assert main(["build", "init", str(tmp_path / "one.v"), "-P", "BITS=16", "-o", str(schema)]) == 0
    assert load_project(schema).modules["one"].parameters == {"BITS": 16}
