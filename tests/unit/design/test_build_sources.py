# SPDX-License-Identifier: Apache-2.0
"""Sources of modules other than Verilog files: VHDL libraries, files of initial values, bitstream settings."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from build_support import MINIMAL, STREAM_MODULE, needs, project

from cm.cli.main import main
from cm.design.boundary.analyse import analyse
from cm.design.errors import BuildError
from cm.design.generate.generation import load_design
from cm.design.generate.outputs import render_all
from cm.design.hdl.errors import HdlError
from cm.design.hdl.ipxact import load_component_xml, load_xci
from cm.design.hdl.model import Polarity
from cm.design.project.load import load_project
from cm.design.runtime.answers import Answers
from cm.schema.problems import SchemaError

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

ENTITY = """\
library ieee; use ieee.std_logic_1164.all;
library filters; use filters.kernels.all;
entity one is
  port (aclk, aresetn : in std_logic;
        s_axis_tdata : in std_logic_vector(31 downto 0); s_axis_tvalid, s_axis_tlast : in std_logic;
        s_axis_tready : out std_logic;
        m_axis_tdata : out std_logic_vector(31 downto 0); m_axis_tvalid, m_axis_tlast : out std_logic;
        m_axis_tready : in std_logic);
end entity;
architecture a of one is begin
  core : entity filters.core port map (aclk => aclk);
end architecture;
"""
KERNELS = "-- écrit en Latin-1\npackage kernels is\n  constant TAPS : integer := 3;\nend package;\n"
CORE = "entity core is port (aclk : in bit); end entity;\narchitecture a of core is begin end architecture;\n"


def vhdl_project(folder: Path, libraries: str) -> Path:
    for name, text in (("one", ENTITY), ("kernels", KERNELS), ("core", CORE)):
        (folder / f"{name}.vhd").write_text(text, encoding="latin-1")
    return project(folder, MINIMAL.replace("sources: [one.v]", f"sources: [one.vhd]\n    libraries: {libraries}"))


def written(path: Path) -> dict[str, str]:
    design = load_design(path)
    return render_all(design.system, design.project.folder / "build", Answers())


def test_vhdl_goes_to_the_library_that_the_build_schema_says(tmp_path: Path) -> None:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    files = written(vhdl_project(tmp_path, "{filters: [kernels.vhd, core.vhd]}"))
    assert 'read_vhdl -vhdl2008 -library filters "$cm_source/core.vhd"' in files["tcl/step_synth_one.tcl"]
    assert 'read_vhdl -vhdl2008 "$cm_source/one.vhd"' in files["tcl/step_synth_one.tcl"]
    assert "../core.vhd" in files["inputs/synth_one.list"].splitlines()


@pytest.mark.parametrize(
    ("libraries", "said"),
    [
        ("{filters: kernels.vhd}", "one.vhd:11: no file of library filters has core; add its file to libraries:"),
        (
            "{other: core.vhd}",
            "one.vhd:2: no file of library filters has kernels; add its file to libraries:",
        ),
        ("{filters: core.vhd, other: kernels.vhd}", "library filters has kernels; it is in other: move its file"),
    ],
)
def test_a_unit_that_no_file_of_its_library_has_is_named(
    libraries: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    assert main(["build", "check", str(vhdl_project(tmp_path, libraries))]) == 1
    assert said in capsys.readouterr().out


def test_a_unit_may_come_with_the_ip_of_the_module(tmp_path: Path) -> None:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    path = vhdl_project(tmp_path, "{filters: kernels.vhd}")
    (problem,) = analyse(load_project(path)).modules["one"].problems
    assert problem.breaks
    (tmp_path / "core.xci").write_text(XCI)
    path.write_text(path.read_text().replace("sources: [one.vhd]", "sources: [one.vhd]\n    ip: [core.xci]"))
    assert analyse(load_project(path)).modules["one"].problems == ()


def test_a_table_that_readmemh_reads_is_an_input_of_synthesis(tmp_path: Path) -> None:
    source = STREAM_MODULE.format(name="one", high=31).replace(
        "endmodule", '    reg [7:0] t [0:3];\n    initial $readmemh("table.hex", t);\nendmodule'
    )
    (tmp_path / "table.hex").write_text("00 01 02 03\n")
    files = written(project(tmp_path, one=source))
    assert "../table.hex" in files["inputs/synth_one.list"].splitlines()


@pytest.mark.parametrize(
    ("setting", "compressed", "per_frame"),
    [
        ("", True, False),
        ("bitstream: {compress: false}\n", False, False),
        ("bitstream: {frame_crc: true}\n", True, True),
    ],
)
def test_bitstreams_are_written_as_the_build_schema_says(
    setting: str, compressed: bool, per_frame: bool, tmp_path: Path
) -> None:
    script = written(project(tmp_path, MINIMAL + setting))["tcl/step_bitstreams_run_1.tcl"]
    assert (f"BITSTREAM.GENERAL.COMPRESS {str(compressed).upper()} " in script) is True
    assert ("BITSTREAM.GENERAL.PERFRAMECRC YES " in script) is per_frame


XCI = """\
{"schema": "xilinx.com:schema:json_instance:1.0",
 "ip_inst": {"xci_name": "fifo_8", "component_reference": "xilinx.com:ip:axis_data_fifo:2.0",
  "boundary": {"ports": {
   "s_axis_aresetn": [{"direction": "in"}], "s_axis_aclk": [{"direction": "in"}],
   "s_axis_tvalid": [{"direction": "in"}], "s_axis_tready": [{"direction": "out"}],
   "s_axis_tdata": [{"direction": "in", "size_left": "7", "size_right": "0"}], "s_axis_tlast": [{"direction": "in"}],
   "m_axis_tvalid": [{"direction": "out"}], "m_axis_tready": [{"direction": "in"}],
   "m_axis_tdata": [{"direction": "out", "size_left": "7", "size_right": "0"}], "m_axis_tlast": [{"direction": "out"}]
 }}}}
"""


def test_an_ip_instance_tells_its_ports_and_its_name(tmp_path: Path) -> None:
    (tmp_path / "fifo_8.xci").write_text(XCI)
    files = written(project(tmp_path, MINIMAL.replace("sources: [one.v]", "ip: [fifo_8.xci]")))
    wrapper = files["wrappers/one/cm_region_prr0.v"]
    assert "fifo_8 inner (" in wrapper
    assert ".s_axis_tdata(s_axis_tdata)" in wrapper
    assert 'read_ip "$cm_source/fifo_8.xci"' in files["tcl/step_synth_one.tcl"]


def test_the_build_schema_says_the_clock_and_the_reset_of_what_no_hdl_describes(tmp_path: Path) -> None:
    (tmp_path / "fifo_8.xci").write_text(XCI.replace('"s_axis_aclk"', '"b_clk": [{"direction": "in"}], "a_clk"'))
    text = MINIMAL.replace("sources: [one.v]", "ip: [fifo_8.xci]")
    text += "    clocks: {a_clk: {interfaces: [s_axis]}, b_clk: {interfaces: [m_axis]}}\n"
    text += "    resets: {s_axis_aresetn: {clock: b_clk, polarity: high}}\n"
    found = analyse(load_project(project(tmp_path, text))).modules["one"]
    assert (found.interface("s_axis").clock, found.interface("m_axis").clock) == ("a_clk", "b_clk")
    assert [(r.port, r.clock, r.polarity, r.why, r.may_be) for r in found.resets] == [
        ("s_axis_aresetn", "b_clk", Polarity.HIGH, "stated", ())
    ]


def test_protocols_of_ones_own_are_found_at_an_ip_instance(tmp_path: Path) -> None:
    (tmp_path / "fifo_8.xci").write_text(
        XCI.replace('"s_axis_tlast"', '"cam_pix": [{"direction": "out"}], "s_axis_tlast"')
    )
    (tmp_path / "own.yaml").write_text("protocols: [{name: pixels, signals: {pix: out}}]\n")
    text = MINIMAL.replace("sources: [one.v]", "ip: [fifo_8.xci]") + "protocols: [own.yaml]\n"
    found = analyse(load_project(project(tmp_path, text))).modules["one"]
    assert found.interface("cam").protocol == "pixels"


def test_a_component_that_cannot_be_read_is_named_at_its_line(tmp_path: Path) -> None:
    (tmp_path / "component.xml").write_text("<a/>")
    path = project(tmp_path, MINIMAL.replace("sources: [one.v]", "sources: [one.v]\n    component: component.xml"))
    with pytest.raises(BuildError, match=r"build\.yaml:7:5: modules\.one\.component: .*its root is <a>"):
        analyse(load_project(path))


@needs("iverilog")
def test_the_wrapper_of_an_ip_instance_elaborates(tmp_path: Path) -> None:
    (tmp_path / "fifo_8.xci").write_text(XCI)
    files = written(project(tmp_path, MINIMAL.replace("sources: [one.v]", "ip: [fifo_8.xci]")))
    (tmp_path / "wrapper.v").write_text(files["wrappers/one/cm_region_prr0.v"])
    stub = (
        STREAM_MODULE.format(name="fifo_8", high=7)
        .replace("clk,", "s_axis_aclk,")
        .replace("resetn,", "s_axis_aresetn,")
    )
    (tmp_path / "stub.v").write_text(stub)
    command = [
        "iverilog",
        "-g2005",
        "-Wall",
        "-Wno-timescale",
        "-s",
        "cm_region_prr0",
        "-o",
        "out",
        "wrapper.v",
        "stub.v",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_ip_instance_without_ports_says_how_to_provide_them(tmp_path: Path) -> None:
    (tmp_path / "old.xci").write_text("<spirit:design/>\n")
    path = project(tmp_path, MINIMAL.replace("sources: [one.v]", "ip: [old.xci]"))
    with pytest.raises(SchemaError, match=r"give component: \(IP-XACT\) or sim_sources"):
        load_design(path)


@pytest.mark.parametrize(
    "text",
    ["<spirit:design/>", "[]", "{}", XCI.replace("json_instance", "xml_instance"), XCI.replace('"ports"', '"pins"')],
)
def test_an_instance_that_lists_no_ports_says_why_that_may_be(text: str, tmp_path: Path) -> None:
    (tmp_path / "old.xci").write_text(text)
    with pytest.raises(HdlError) as refused:
        load_xci(tmp_path / "old.xci")
    assert str(refused.value) == (
        f"{tmp_path / 'old.xci'}: has no list of ports (it is of a Vivado before 2020.2, or its output products were "
        "never generated): give component: or sim_sources:"
    )
    with pytest.raises(HdlError, match=r"none\.xci: cannot be read: No such file or directory$"):
        load_xci(tmp_path / "none.xci")


COMPONENT = """\
<?xml version="1.0" encoding="UTF-8"?>
<spirit:component xmlns:spirit="http://www.spiritconsortium.org/XMLSchema/SPIRIT/1685-2009"
 xmlns:xilinx="http://www.xilinx.com">
 <spirit:name>one</spirit:name>
 <spirit:model><spirit:ports>{ports}</spirit:ports></spirit:model>
</spirit:component>
"""
WIRE = "<spirit:wire><spirit:direction>in</spirit:direction></spirit:wire>"
PORT = f"<spirit:port><spirit:name>{{}}</spirit:name>{WIRE}{{}}</spirit:port>"
HIDDEN = (
    "<spirit:vendorExtensions><xilinx:portInfo><xilinx:enablement>"
    '<xilinx:isEnabled xilinx:id="PORT_ENABLEMENT.hidden">{}</xilinx:isEnabled>'
    "</xilinx:enablement></xilinx:portInfo></spirit:vendorExtensions>"
)


def test_ports_that_a_component_hides_are_not_there(tmp_path: Path) -> None:
    ports = PORT.format("seen", HIDDEN.format("true")) + PORT.format("hidden", HIDDEN.format("false"))
    (tmp_path / "component.xml").write_text(COMPONENT.format(ports=ports))
    assert [port.name for port in load_component_xml(tmp_path / "component.xml").ports] == ["seen"]
