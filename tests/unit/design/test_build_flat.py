# SPDX-License-Identifier: Apache-2.0
"""Tops with SystemVerilog interfaces or VHDL records: a flat wrapper is generated, or there is a reason."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from build_support import MINIMAL, needs, project

from cm.cli.main import main
from cm.design.generate.generation import generate, load_design, output_folder
from cm.design.hdl.flat_wrappers import field_name

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
pytest.importorskip("jinja2", reason="needs jinja2: the extra [build] is not installed")

STREAM = """\
interface stream_if #(parameter W = 8, parameter K = W / 8) ();
    logic [W-1:0] tdata;
    logic [K-1:0] tkeep;
    logic tvalid, tready, tlast;
    modport src (output tdata, tkeep, tvalid, tlast, input tready);
    modport snk (input tdata, tkeep, tvalid, tlast, output tready);
endinterface
"""
TOP = """\
module one #(parameter DEPTH = 2) (input wire clk, input wire rst, stream_if.snk s_axis, stream_if.src m_axis,
                                   output wire [3:0] level);
    assign m_axis.tdata = s_axis.tdata;
    assign m_axis.tkeep = s_axis.tkeep;
    assign m_axis.tvalid = s_axis.tvalid & ~rst & clk;
    assign m_axis.tlast = s_axis.tlast;
    assign s_axis.tready = m_axis.tready;
    assign level = DEPTH[3:0];
endmodule
"""


def of_interfaces(folder: Path, top: str = TOP, keys: str = "parameters: {DEPTH: 3}") -> Path:
    (folder / "stream_if.sv").write_text(STREAM)
    (folder / "one.sv").write_text(top)
    both = f"interface_parameters: {{s_axis: {{W: 32}}, m_axis: {{W: 32}}}}\n    {keys}"
    return project(folder, MINIMAL.replace("[one.v]", f"[stream_if.sv, one.sv]\n    {both}"))


def written(path: Path) -> Path:
    design = load_design(path)
    out = output_folder(design.project, None)
    generate(design, out)
    return out


def verilator(top: str, *files: Path) -> None:
    command = ["verilator", "--lint-only", "-Wall", "-Wno-UNUSED", "--top-module", top, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def ghdl(folder: Path, top: str, *files: tuple[str, Path]) -> None:
    """Analyse the files, each in its library, and elaborate."""
    steps = [["-a", f"--work={library}", str(file)] for library, file in files]
    for action, *words in [*steps, ["-e", top]]:
        done = subprocess.run(
            ["ghdl", action, "--std=08", *words], cwd=folder, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")


@needs("verilator")
def test_interfaces_get_a_wrapper_that_verilator_elaborates(tmp_path: Path) -> None:
    out = written(of_interfaces(tmp_path))
    flat = out / "wrappers/one/cm_flat_one.sv"
    text = flat.read_text()
    assert "stream_if #(.W(32)) s_axis ();" in text
    assert "input  wire [3:0] s_axis_tkeep" in text
    assert "one #(.DEPTH(3)) inner (" in text
    wrapper = out / "wrappers/one/cm_region_prr0.v"
    assert "cm_flat_one inner (" in wrapper.read_text()
    verilator("cm_region_prr0", wrapper, flat, tmp_path / "stream_if.sv", tmp_path / "one.sv")
    script = (out / "tcl/step_synth_one.tcl").read_text()
    assert "read_verilog -sv wrappers/one/cm_flat_one.sv" in script


@needs("verilator")
def test_an_array_of_interfaces_becomes_as_many_buses(tmp_path: Path) -> None:
    top = TOP.replace("stream_if.snk s_axis,", "stream_if.snk s_axis [2],").replace("s_axis.", "s_axis[1].")
    out = written(
        of_interfaces(tmp_path, top.replace("assign level", "assign s_axis[0].tready = 1;\n    assign level"))
    )
    text = (out / "wrappers/one/cm_flat_one.sv").read_text()
    assert "stream_if #(.W(32)) s_axis [2] ();" in text
    assert "assign s_axis[1].tdata = s_axis_1_tdata;" in text
    verilator("cm_flat_one", out / "wrappers/one/cm_flat_one.sv", tmp_path / "stream_if.sv", tmp_path / "one.sv")


def test_check_shows_the_buses_of_interfaces(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "check", str(of_interfaces(tmp_path))]) == 0
    assert "module one (cm_flat_one, systemverilog)\n  s_axis: axis slave, 32 bits\n" in capsys.readouterr().out


def test_init_takes_a_top_with_interfaces(tmp_path: Path) -> None:
    of_interfaces(tmp_path)
    (tmp_path / "build.yaml").unlink()
    files = [str(tmp_path / name) for name in ("stream_if.sv", "one.sv")]
    path = tmp_path / "build.yaml"
    assert main(["build", "init", *files, "-o", str(path)]) == 0
    assert main(["build", "check", str(path)]) == 0
    assert "top: " not in path.read_text()


def test_an_interface_inside_a_module_is_not_reported_as_a_missing_module(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = of_interfaces(tmp_path, TOP.replace("assign level", "stream_if between ();\n    assign level"))
    assert main(["build", "check", str(path)]) == 0
    assert "no file has" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("stream_if.snk s_axis,", "stream_if s_axis,"), "port s_axis is stream_if without a modport"),
        (("stream_if.snk s_axis,", "stream_if.snk s_axis [2][2],"), "port s_axis is an array of arrays of interfaces"),
        (("stream_if.snk s_axis,", "other_if.snk s_axis,"), "port s_axis"),
        (("output wire [3:0] level", "output real level"), "port level is neither an interface nor a vector of bits"),
        (("output wire [3:0] level", "output wire s_axis_tdata"), "would have two ports s_axis_tdata"),
    ],
)
def test_if_no_wrapper_is_possible_check_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture, change: tuple[str, str], said: str
) -> None:
    assert main(["build", "check", str(of_interfaces(tmp_path, TOP.replace(*change)))]) == 1
    caught = capsys.readouterr()
    assert said in caught.out + caught.err


CLOCKED_STREAM = STREAM.replace("()", "(input logic aclk, aresetn)", 1)


def with_clocked_interface(folder: Path, clocks: str) -> Path:
    path = of_interfaces(folder, TOP.replace("input wire clk, input wire rst, ", clocks).replace(" & ~rst & clk", ""))
    (folder / "stream_if.sv").write_text(CLOCKED_STREAM)
    return path


@needs("verilator")
@pytest.mark.parametrize(
    ("clocks", "tied"),
    [
        ("input wire clk, input wire rst, ", "(.aclk(clk), .aresetn(~rst))"),
        ("input wire aclk, input wire aresetn, input wire pix_clk, ", "(.aclk(aclk), .aresetn(aresetn))"),
        ("", "(.aclk(aclk), .aresetn(aresetn))"),  # the wrapper gets them as ports
    ],
)
def test_an_interface_with_a_clock_and_a_reset_of_its_own_gets_the_modules(
    clocks: str, tied: str, tmp_path: Path
) -> None:
    path = with_clocked_interface(tmp_path, clocks)
    if "pix" in clocks:
        path.write_text(path.read_text().replace("{pblock: auto}", "{pblock: auto, clocks: {pix_clk: fclk0}}"))
    out = written(path)
    text = (out / "wrappers/one/cm_flat_one.sv").read_text()
    assert f"stream_if #(.W(32)) s_axis {tied};" in text
    verilator("cm_flat_one", out / "wrappers/one/cm_flat_one.sv", tmp_path / "stream_if.sv", tmp_path / "one.sv")


def test_a_clock_of_an_interface_that_may_be_any_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = with_clocked_interface(tmp_path, "input wire wr_clk, input wire rd_clk, input wire rst, ")
    assert main(["build", "check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "the interface of s_axis has a port aclk, which may be any of wr_clk, rd_clk: give them one name" in said


def test_the_clock_of_a_bus_of_a_wrapper_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    top = TOP.replace("input wire clk, ", "input wire wr_clk, input wire rd_clk, ").replace(" & ~rst & clk", "")
    main(["build", "check", str(of_interfaces(tmp_path, top))])
    assert "the clock of s_axis could not be determined: the clocks are wr_clk, rd_clk" in capsys.readouterr().out


def test_interface_parameters_for_an_unknown_port_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = of_interfaces(tmp_path)
    path.write_text(path.read_text().replace("{s_axis:", "{s_axix:"))
    assert main(["build", "check", str(path)]) == 1
    assert "one has no interface port s_axix; there are: s_axis, m_axis" in capsys.readouterr().out


PACKAGE = """\
library ieee; use ieee.std_logic_1164.all; use ieee.numeric_std.all;
package lite_pkg is
  subtype width_t is positive range 1 to 32;
  subtype word_t is std_ulogic_vector(width_t'high - 1 downto 0);
  type addr_t is record valid : std_ulogic; addr : u_unsigned(7 downto 0); end record;
  type ready_t is record ready : std_ulogic; end record;
  type data_t is record valid : std_ulogic; data : word_t; strb : std_ulogic_vector(3 downto 0); end record;
  type answer_t is record valid : std_ulogic; resp : std_ulogic_vector(1 downto 0); end record;
  type read_t is record valid : std_ulogic; data : word_t; resp : std_ulogic_vector(1 downto 0); end record;
  type m2s_read_t is record ar : addr_t; r : ready_t; end record;
  type m2s_write_t is record aw : addr_t; w : data_t; b : ready_t; end record;
  type m2s_t is record read : m2s_read_t; write : m2s_write_t; end record;
  type s2m_read_t is record ar : ready_t; r : read_t; end record;
  type s2m_write_t is record aw, w : ready_t; b : answer_t; end record;
  type s2m_t is record read : s2m_read_t; write : s2m_write_t; end record;
end package;
"""
RECORDS = """\
library ieee; use ieee.std_logic_1164.all; use ieee.numeric_std.all;
library lite; use lite.lite_pkg.all;
entity one is
  generic (ANSWER : natural := 1);
  port (aclk : in std_ulogic; aresetn : in std_ulogic; level : out u_unsigned(3 downto 0);
        s_axi_m2s : in m2s_t; s_axi_s2m : out s2m_t);
end entity;
architecture a of one is begin
  level <= to_unsigned(ANSWER, 4);
  s_axi_s2m.read.ar.ready <= '1';
  s_axi_s2m.read.r <= (valid => s_axi_m2s.read.ar.valid, data => (others => '0'), resp => "00");
  s_axi_s2m.write.aw.ready <= '1';
  s_axi_s2m.write.w.ready <= '1';
  s_axi_s2m.write.b <= (valid => s_axi_m2s.write.w.valid, resp => "00");
end architecture;
"""


def of_records(folder: Path, package: str = PACKAGE) -> Path:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    (folder / "lite_pkg.vhd").write_text(package)
    (folder / "one.vhd").write_text(RECORDS)
    keys = "[one.vhd]\n    libraries: {lite: [lite_pkg.vhd]}\n    parameters: {ANSWER: 5}"
    return project(folder, MINIMAL.replace("[one.v]", keys))


@needs("ghdl")
def test_records_get_a_wrapper_that_ghdl_elaborates(tmp_path: Path) -> None:
    out = written(of_records(tmp_path))
    flat = out / "wrappers/one/cm_flat_one.vhd"
    text = flat.read_text()
    assert "s_axi_araddr : in std_logic_vector(7 downto 0)" in text
    assert "s_axi_wdata : in std_logic_vector(31 downto 0)" in text
    assert "generic map (ANSWER => 5)" in text
    ghdl(tmp_path, "cm_flat_one", ("lite", tmp_path / "lite_pkg.vhd"), ("work", tmp_path / "one.vhd"), ("work", flat))


def test_check_shows_the_bus_of_records(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "check", str(of_records(tmp_path))]) == 0
    assert "module one (cm_flat_one, vhdl)\n  s_axi: axi4lite slave, 32 bits\n" in capsys.readouterr().out


STREAM_RECORDS = """\
library ieee; use ieee.std_logic_1164.all;
package stream_pkg is
  type down_t is record
    tdata : std_logic_vector(31 downto 0); tvalid : std_logic; tlast : std_logic;
  end record;
  type up_t is record
    tready : std_logic;
  end record;
end package;
library ieee; use ieee.std_logic_1164.all; use work.stream_pkg.all;
entity one is
  port (aclk : in std_logic; aresetn : in std_logic;
        s_axis_i : in down_t; s_axis_o : out up_t; m_axis_o : out down_t; m_axis_i : in up_t);
end entity;
architecture rtl of one is begin
  m_axis_o <= s_axis_i;
  s_axis_o <= m_axis_i;
end architecture;
"""


def of_stream_records(folder: Path, text: str = STREAM_RECORDS) -> Path:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    (folder / "one.vhd").write_text(text)
    return project(folder, MINIMAL.replace("one.v", "one.vhd"))


def test_two_records_that_differ_in_i_and_o_are_one_bus(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = of_stream_records(tmp_path)
    assert main(["build", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert "  s_axis: axis slave, 32 bits\n  m_axis: axis master, 32 bits\n" in said
    assert "left over" not in said
    text = (written(path) / "wrappers/one/cm_flat_one.vhd").read_text()
    assert "  record_s_axis_i.tdata <= s_axis_tdata;\n" in text
    assert "  s_axis_tready <= record_s_axis_o.tready;\n" in text


HALVES = """\
library ieee; use ieee.std_logic_1164.all;
package half_pkg is
  type axi_read_in_r is record arready, rvalid : std_logic; rdata : std_logic_vector(31 downto 0);
    rresp : std_logic_vector(1 downto 0); end record;
  type axi_read_out_r is record araddr : std_logic_vector(11 downto 0); arvalid, rready : std_logic; end record;
  type axi_write_in_r is record awready, wready, bvalid : std_logic; bresp : std_logic_vector(1 downto 0); end record;
  type axi_write_out_r is record awaddr : std_logic_vector(11 downto 0); wdata : std_logic_vector(31 downto 0);
    wstrb : std_logic_vector(3 downto 0); awvalid, wvalid, bready : std_logic; end record;
end package;
library ieee; use ieee.std_logic_1164.all; use work.half_pkg.all;
entity one is
  port (aclk, aresetn : in std_logic; s_axi_ro : out axi_read_in_r; s_axi_ri : in axi_read_out_r;
        s_axi_wo : out axi_write_in_r; s_axi_wi : in axi_write_out_r);
end entity;
architecture rtl of one is begin end architecture;
"""


def test_records_of_the_reading_and_the_writing_half_are_one_bus(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    main(["build", "check", str(of_stream_records(tmp_path, HALVES))])
    assert "  s_axi: axi4lite slave, 32 bits\n" in capsys.readouterr().out


def test_i_and_o_stay_the_names_of_two_whole_buses(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    ports = "axis_i : in down_t; axis_i_s2m : out up_t; axis_o : out down_t; axis_o_s2m : in up_t"
    text = STREAM_RECORDS.replace("s_axis_i : in down_t; s_axis_o : out up_t; ", f"{ports}; ")
    text = text.replace("m_axis_o : out down_t; m_axis_i : in up_t", "level : out std_logic")
    text = text.replace("m_axis_o <= s_axis_i", "axis_o <= axis_i").replace(
        "s_axis_o <= m_axis_i", "axis_i_s2m <= axis_o_s2m"
    )
    assert main(["build", "check", str(of_stream_records(tmp_path, text))]) == 0
    assert "  axis_i: axis slave, 32 bits\n  axis_o: axis master, 32 bits\n" in capsys.readouterr().out


def test_a_left_over_handshake_stops_check(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    text = STREAM_RECORDS.replace("s_axis_o", "other_o").replace("m_axis_i : in", "m_axis_i : in")
    assert main(["build", "check", str(of_stream_records(tmp_path, text))]) == 1
    said = capsys.readouterr().out
    assert "would be refused: " in said
    assert "other_o_tready is of a handshake, and the rest of its bus was not found with it" in said


@needs("ghdl")
def test_a_top_in_a_separate_library_is_reached_through_a_wrapper(tmp_path: Path) -> None:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    vector = "std_logic_vector(31 downto 0)"
    ports = f"aclk, aresetn, s_axis_tvalid, s_axis_tlast, m_axis_tready : in bit_t; s_axis_tdata : in {vector}; "
    ports += f"s_axis_tready, m_axis_tvalid, m_axis_tlast : out bit_t; m_axis_tdata : out {vector}"
    text = "library ieee; use ieee.std_logic_1164.all;\npackage kinds is subtype bit_t is std_ulogic; end package;\n"
    text += "library ieee; use ieee.std_logic_1164.all; use work.kinds.all;\n"
    text += (
        f"entity one is port ({ports}); end entity;\narchitecture a of one is begin\n  m_axis_tdata <= s_axis_tdata;\n"
    )
    text += "  m_axis_tvalid <= s_axis_tvalid; m_axis_tlast <= s_axis_tlast; s_axis_tready <= m_axis_tready;\n"
    text += "end architecture;\n"
    (tmp_path / "one.vhd").write_text(text)
    path = project(tmp_path, MINIMAL.replace("sources: [one.v]", "libraries: {filters: [one.vhd]}"))
    out = written(path)
    flat = out / "wrappers/one/cm_flat_one.vhd"
    assert "inner : entity filters.one" in flat.read_text()
    assert "cm_flat_one inner (" in (out / "wrappers/one/cm_region_prr0.v").read_text()
    ghdl(tmp_path, "cm_flat_one", ("filters", tmp_path / "one.vhd"), ("work", flat))


def test_a_record_with_a_field_that_is_not_a_vector_names_the_field(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    package = PACKAGE.replace("data : word_t; strb", "data : integer; strb")
    assert main(["build", "check", str(of_records(tmp_path, package))]) == 1
    caught = capsys.readouterr()
    assert "port s_axi_m2s.write.w.data is integer, not a vector of bits" in caught.out + caught.err


@pytest.mark.parametrize(
    ("port", "path", "stream", "name"),
    [
        ("axi_lite_m2s", ["read", "ar", "addr"], False, "axi_lite_araddr"),  # hdl-modules
        ("axilReadMaster", ["araddr"], False, "axil_araddr"),  # SURF
        ("sAxisMaster", ["tValid"], False, "sAxis_tvalid"),
        ("stream_m2s", ["strobe"], True, "stream_tstrb"),
        ("master", ["x"], False, "master_x"),
    ],
)
def test_fields_are_named_as_buses_are(port: str, path: list[str], stream: bool, name: str) -> None:
    assert field_name(port, path, stream) == name


def test_one_channel_of_axi_is_no_stream(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    text = STREAM_RECORDS.replace("down_t", "axi_m2s_w_t").replace("up_t", "axi_s2m_w_t")
    path = of_stream_records(
        tmp_path, text.replace("tdata", "data").replace("tvalid", "valid").replace("tready", "ready")
    )
    assert main(["build", "check", str(path)]) == 1
    assert "looks like the AXI bus s_axis, but" in capsys.readouterr().out
