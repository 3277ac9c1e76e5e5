# SPDX-License-Identifier: Apache-2.0
"""Modules given in other forms than HDL: FuseSoC cores, IP-XACT components, IP instances."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
import yaml
from build_support import MINIMAL, STREAM_MODULE, project
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_build_sources import XCI

from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.hdl.errors import HdlError
from cm.design.hdl.ipxact import component_files
from cm.design.project.fusesoc import core_files, names

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
pytest.importorskip("jinja2", reason="needs jinja2: the extra [build] is not installed")

CORE = """\
CAPI=2:
name: acme:video:filter:1.2.0
filesets:
  rtl:
    files:
      - "tool_vivado? (filter.v) !tool_vivado? (other.v)"
      - width.vh: {is_include_file: true}
      - notes.txt: {file_type: user}
    file_type: verilogSource
    depend: [">=acme:video:taps:1.0", "tool_verilator? (acme:sim:none)"]
  timing: {files: [filter.xdc: {file_type: xdc}]}
  bench: {files: [bench.v], file_type: verilogSource}
targets:
  default: &default
    filesets: [rtl]
    filesets_append: [timing]
    toplevel: filter
    parameters: [HIGH, "is_toplevel? (DEPTH=4)", FAST=true]
  sim:
    <<: *default
    filesets_append: [bench]
parameters:
  HIGH: {datatype: int, default: 15, paramtype: vlogparam}
  DEPTH: {datatype: int, paramtype: vlogparam}
  FAST: {datatype: bool, paramtype: vlogdefine}
"""
TAPS = "CAPI=2:\nname: acme:video:taps:{version}\nfilesets: {{rtl: {{files: [taps.v], file_type: verilogSource}}}}\n"
TAPS += "targets: {{default: {{filesets: [rtl]}}}}\n"


def cores(folder: Path, version: str = "1.1") -> Path:
    """A core that depends on another in a folder beside it."""
    (folder / "filter").mkdir()
    (folder / "taps").mkdir()
    text = STREAM_MODULE.format(name="filter", high="HIGH").replace(
        "module filter (", '`include "width.vh"\nmodule filter #(parameter HIGH = 7, DEPTH = 1) ('
    )
    (folder / "filter/filter.v").write_text(text.replace("endmodule", "    taps taps_i ();\nendmodule"))
    (folder / "filter/width.vh").write_text("`define WIDTH 8\n")
    (folder / "filter/filter.xdc").write_text("")
    (folder / "filter/filter.core").write_text(CORE)
    (folder / "taps/taps.core").write_text(TAPS.format(version=version))
    (folder / "taps/taps.v").write_text("module taps; endmodule\n")
    return folder / "filter/filter.core"


def test_a_core_brings_its_target_with_what_it_depends_on_before_it(tmp_path: Path) -> None:
    found = core_files(cores(tmp_path), roots=[tmp_path])
    assert [path.name for path in found.sources] == ["taps.v", "filter.v"]
    assert [path.name for path in found.own] == ["filter.v"]
    assert [path.name for path in found.constraints] == ["filter.xdc"]
    assert [path.name for path in found.include_dirs] == ["filter"]
    assert found.top == "filter"
    assert found.parameters == {"HIGH": 15, "DEPTH": 4}
    assert found.defines == {"FAST": "1"}
    assert found.missing == []


def test_a_target_passes_text_parameters_unchanged_and_refuses_bad_numbers(tmp_path: Path) -> None:
    core = cores(tmp_path)
    core.write_text(CORE.replace("parameters: [HIGH", "parameters: [HIGH=*x"))
    with pytest.raises(BuildError, match=r"the parameter HIGH is given '\*x', which is not a value"):
        core_files(core, roots=[tmp_path])
    core.write_text(core.read_text().replace("HIGH: {datatype: int, default: 15", "HIGH: {datatype: str"))
    assert core_files(core, roots=[tmp_path]).parameters["HIGH"] == "*x"


@pytest.mark.parametrize(
    ("text", "held"),
    [
        ("a.v", ["a.v"]),
        ("tool_vivado? (a.v b.v) c.v", ["a.v", "b.v", "c.v"]),
        ("!tool_vivado? (a.v) !x? (b.v)", ["b.v"]),
        ("tool_vivado? (x? (a.v) b.v)", ["b.v"]),
        ("x? (tool_vivado? (a.v)) b.v", ["b.v"]),
    ],
)
def test_flags_of_a_core_are_those_of_vivado(text: str, held: list[str]) -> None:
    assert names(text, frozenset(["tool_vivado"])) == held


def test_a_core_that_is_not_there_or_too_old_is_named(tmp_path: Path) -> None:
    core = cores(tmp_path, "0.9")
    (said,) = core_files(core).missing
    assert "no core >=acme:video:taps:1.0: name its folder (core_roots:, or --cores)" in said
    (said,) = core_files(core, roots=[tmp_path]).missing
    assert said.endswith("there is version 0.9")


def test_what_is_not_a_core_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.core").write_text("[main]\nname = a\n")
    with pytest.raises(BuildError, match="not a FuseSoC core file"):
        core_files(tmp_path / "a.core")
    (tmp_path / "a.core").write_text("CAPI=2:\n[main]\n")
    with pytest.raises(BuildError, match=r"CAPI1 core|not a FuseSoC core file"):
        core_files(tmp_path / "a.core")
    (tmp_path / "a.core").write_text("CAPI=2:\nname: a\n")
    with pytest.raises(BuildError, match="no target default; there are: none"):
        core_files(tmp_path / "a.core")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("filesets: [rtl]", "filesets: 3"),
        ("filesets: [rtl]", "filesets: [[rtl]]"),
        ("targets:\n", "targets: [default]\nmore:\n"),
        ("files: [filter.xdc: {file_type: xdc}]", "files: {a: 1}"),
        ("HIGH: {datatype: int, default: 15, paramtype: vlogparam}", "HIGH: 4"),
        ("file_type: verilogSource\n    depend", "file_type: [x]\n    depend"),
        ("FAST=true", "FAST=>true"),
    ],
)
def test_a_core_of_another_shape_is_refused_or_read(tmp_path: Path, old: str, new: str) -> None:
    core = cores(tmp_path)
    assert old in CORE
    core.write_text(CORE.replace(old, new))
    with contextlib.suppress(BuildError):
        core_files(core, roots=[tmp_path])


def begun(folder: Path, *words: str) -> dict[str, dict[str, object]]:
    """Return the modules of the schema that `init` writes, once it has passed check and been generated."""
    path = folder / "build.yaml"
    assert main(["build", "init", *words, "-o", str(path)]) == 0
    assert main(["build", "check", str(path)]) == 0
    assert main(["build", "generate", str(path)]) == 0
    modules: dict[str, dict[str, object]] = yaml.safe_load(path.read_text(encoding="utf-8"))["modules"]
    return modules


def test_init_takes_a_core(tmp_path: Path) -> None:
    modules = begun(tmp_path, str(cores(tmp_path)), "--cores", str(tmp_path))
    assert modules == {"filter": {"core": "filter/filter.core", "core_roots": ["."]}}
    script = (tmp_path / "build/tcl/step_synth_filter.tcl").read_text()
    assert script.index("taps.v") < script.index("filter.v")
    assert "-verilog_define [list FAST]" in script
    assert ".HIGH(15)" in (tmp_path / "build/wrappers/filter/cm_region_prr0.v").read_text()


def test_a_core_in_a_build_schema_says_what_it_lacks_with_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    core = cores(tmp_path)
    path = project(tmp_path, MINIMAL.replace("sources: [one.v]", f"core: {core}"))
    assert main(["build", "check", str(path)]) == 1
    assert "build.yaml:6:5: modules.one.core: " in capsys.readouterr().err


COMPONENT = """\
<?xml version="1.0"?>
<spirit:component xmlns:spirit="http://www.spiritconsortium.org/XMLSchema/SPIRIT/1685-2009">
 <spirit:name>one</spirit:name>
 <spirit:model><spirit:views>
  <spirit:view><spirit:name>v</spirit:name>
   <spirit:envIdentifier>verilogSource:vivado.xilinx.com:synthesis</spirit:envIdentifier>
   <spirit:modelName>one</spirit:modelName><spirit:fileSetRef><spirit:localName>a</spirit:localName></spirit:fileSetRef>
  </spirit:view>
  <spirit:view><spirit:name>h</spirit:name>
   <spirit:envIdentifier>vhdlSource:vivado.xilinx.com:synthesis</spirit:envIdentifier>
   <spirit:fileSetRef><spirit:localName>b</spirit:localName></spirit:fileSetRef>
  </spirit:view></spirit:views></spirit:model>
 <spirit:fileSets>
  <spirit:fileSet><spirit:name>a</spirit:name>
   <spirit:file><spirit:name>hdl/one.v</spirit:name><spirit:fileType>verilogSource</spirit:fileType></spirit:file>
   <spirit:file><spirit:name>hdl/w.vh</spirit:name><spirit:fileType>verilogSource</spirit:fileType>
    <spirit:isIncludeFile>true</spirit:isIncludeFile></spirit:file></spirit:fileSet>
  <spirit:fileSet><spirit:name>b</spirit:name>
   <spirit:file><spirit:name>hdl/one.vhd</spirit:name><spirit:fileType>vhdlSource</spirit:fileType></spirit:file>
  </spirit:fileSet></spirit:fileSets>
</spirit:component>
"""


@pytest.mark.parametrize(
    ("library", "named"), [("", False), ("work", False), ("xil_defaultlib", False), ("filters", True)]
)
def test_vhdl_of_a_component_is_in_the_library_that_it_names(library: str, named: bool, tmp_path: Path) -> None:
    text = COMPONENT.replace("verilogSource:vivado", "vhdlSource:vivado")
    kind = "<spirit:fileType>vhdlSource</spirit:fileType>"
    text = text.replace(kind, f"{kind}<spirit:logicalName>{library}</spirit:logicalName>")
    (tmp_path / "component.xml").write_text(text)
    with pytest.raises(HdlError, match=r"component\.xml: lists hdl/one\.v, which is not there"):
        component_files(tmp_path / "component.xml")
    (tmp_path / "hdl").mkdir()
    for name in ("one.v", "w.vh", "one.vhd"):
        (tmp_path / "hdl" / name).touch()
    found = component_files(tmp_path / "component.xml")
    verilog, vhdl = tmp_path / "hdl/one.v", tmp_path / "hdl/one.vhd"
    assert (found.sources, found.libraries) == (([verilog], {library: [vhdl]}) if named else ([verilog, vhdl], {}))
    assert found.include_dirs == [tmp_path / "hdl"]


def test_a_component_that_needs_other_ip_says_what_to_give_instead(tmp_path: Path) -> None:
    other = '<spirit:componentRef spirit:vendor="xilinx.com" spirit:name="fifo_generator"/></spirit:fileSet>'
    (tmp_path / "component.xml").write_text(COMPONENT.replace("</spirit:fileSet>", other, 1))
    with pytest.raises(HdlError, match=r"component\.xml: needs other IP \(fifo_generator\): make an instance of it in"):
        component_files(tmp_path / "component.xml")


def test_constraints_of_a_component_are_those_of_its_synthesis(tmp_path: Path) -> None:
    view = """<spirit:view><spirit:name>c</spirit:name>
     <spirit:envIdentifier>:vivado.xilinx.com:synthesis.constraints</spirit:envIdentifier>
     <spirit:fileSetRef><spirit:localName>c</spirit:localName></spirit:fileSetRef></spirit:view></spirit:views>"""
    files = "".join(
        f"<spirit:file><spirit:name>{name}.xdc</spirit:name><spirit:userFileType>{kind}</spirit:userFileType></spirit:file>"
        for name, kind in (("timing", "xdc"), ("places", "USED_IN_implementation"))
    )
    held = f"<spirit:fileSet><spirit:name>c</spirit:name>{files}</spirit:fileSet></spirit:fileSets>"
    text = COMPONENT.replace("</spirit:views>", view).replace("</spirit:fileSets>", held)
    (tmp_path / "component.xml").write_text(text)
    (tmp_path / "hdl").mkdir()
    for name in ("hdl/one.v", "hdl/w.vh", "timing.xdc", "places.xdc"):
        (tmp_path / name).touch()
    found = component_files(tmp_path / "component.xml")
    assert (found.sources, found.constraints) == ([tmp_path / "hdl/one.v"], [tmp_path / "timing.xdc"])


def test_init_takes_a_component_with_the_files_of_its_synthesis(tmp_path: Path) -> None:
    (tmp_path / "ip/hdl").mkdir(parents=True)
    (tmp_path / "ip/component.xml").write_text(COMPONENT)
    (tmp_path / "ip/hdl/one.v").write_text(STREAM_MODULE.format(name="one", high=31))
    (tmp_path / "ip/hdl/w.vh").write_text("")
    path = tmp_path / "build.yaml"
    assert main(["build", "init", str(tmp_path / "ip/component.xml"), "-o", str(path)]) == 1
    # a component without bus interfaces of its own has nothing for a region: one is stated here
    stated = """<spirit:busInterfaces><spirit:busInterface><spirit:name>S_AXIS</spirit:name>
     <spirit:busType spirit:vendor="xilinx.com" spirit:library="interface" spirit:name="axis" spirit:version="1.0"/>
     <spirit:slave/><spirit:portMaps>{maps}</spirit:portMaps></spirit:busInterface></spirit:busInterfaces>"""
    signals = ("TDATA", "TVALID", "TREADY", "TLAST")
    maps = "".join(
        f"<spirit:portMap><spirit:logicalPort><spirit:name>{s}</spirit:name></spirit:logicalPort><spirit:physicalPort>"
        f"<spirit:name>s_axis_{s.lower()}</spirit:name></spirit:physicalPort></spirit:portMap>"
        for s in signals
    )
    ports = "<spirit:ports>" + "".join(
        f"<spirit:port><spirit:name>s_axis_{s.lower()}</spirit:name><spirit:wire><spirit:direction>"
        f"{'out' if s == 'TREADY' else 'in'}</spirit:direction></spirit:wire></spirit:port>"
        for s in signals
    )
    text = COMPONENT.replace("<spirit:model>", stated.format(maps=maps) + "<spirit:model>")
    text = text.replace("</spirit:views>", f"</spirit:views>{ports}</spirit:ports>")
    (tmp_path / "ip/component.xml").write_text(text)
    modules = begun(tmp_path, str(tmp_path / "ip/component.xml"))
    assert modules == {
        "one": {"component": "ip/component.xml", "sources": ["ip/hdl/one.v"], "include_dirs": ["ip/hdl"]}
    }


def test_init_takes_an_instance_of_ip(tmp_path: Path) -> None:
    (tmp_path / "fifo_8.xci").write_text(XCI)
    assert begun(tmp_path, str(tmp_path / "fifo_8.xci")) == {"fifo_8": {"ip": ["fifo_8.xci"]}}


def test_cpp_is_refused_with_the_way_to_what_can_be_read(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "copy.cpp").write_text("void copy(int x) {}\n")
    assert main(["build", "init", str(tmp_path / "copy.cpp"), "-o", str(tmp_path / "build.yaml")]) == 1
    assert "run Vitis HLS, and give the component.xml or the Verilog that it wrote" in capsys.readouterr().err
    path = project(tmp_path, MINIMAL.replace("sources: [one.v]", "hls: {sources: [copy.cpp]}"))
    assert main(["build", "check", str(path)]) == 1
    said = capsys.readouterr().err
    assert "build.yaml:6:5: modules.one.hls: unknown key 'hls'" in said
    assert "run Vitis HLS, and give" in said


def damaged(text: str) -> st.SearchStrategy[str]:
    """`text` with a piece removed, doubled, or inserted."""
    place = st.integers(0, len(text))
    noise = st.text(alphabet='(){}<>[];:,*&"#/\\? \nabc019=', max_size=12)
    return st.builds(lambda a, b, n: text[: min(a, b)] + n + text[max(a, b) :] * (1 + len(n) % 2), place, place, noise)


@given(damaged(CORE))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_damage_of_a_core_is_read_or_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.core").write_text(text)
    with contextlib.suppress(BuildError):
        core_files(tmp_path / "a.core")


@given(damaged(COMPONENT))
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_damage_of_a_component_is_read_or_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "component.xml").write_text(text)
    with contextlib.suppress(HdlError):
        component_files(tmp_path / "component.xml")
