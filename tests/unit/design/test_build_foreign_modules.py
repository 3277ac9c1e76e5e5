# SPDX-License-Identifier: Apache-2.0
"""Modules given in other forms than HDL: FuseSoC cores, IP-XACT components, IP instances, C++ for Vitis HLS."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from build_support import MINIMAL, STREAM_MODULE, needs, project
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_build_sources import XCI
from test_build_tcl import TCL, replay, scripts

from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.generate.tree import generate, load_design, output_folder
from cm.design.hdl.errors import HdlError
from cm.design.hdl.hls import hls_registers, load_hls
from cm.design.hdl.ipxact_files import component_files
from cm.design.project.fusesoc import core_files, names
from cm.design.project.model import HlsSpec

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


AXIS = """\
#include "sizes.h"
typedef ap_axis<WORD * 2, 0, 0, 0> packet;
// void copy(int x) { is a comment }
static void inner(hls::stream<packet> &from, hls::stream<packet> &to) { to.write(from.read()); }
void copy(hls::stream<packet> &strm_in, hls::stream<packet> &strm_out) {
#pragma HLS INTERFACE ap_ctrl_none port=return
#pragma HLS INTERFACE axis port=strm_in
#pragma HLS INTERFACE mode=axis port=strm_out
    inner(strm_in, strm_out);
}
"""


def test_streams_of_cpp_have_the_ports_that_vitis_hls_gave_them(tmp_path: Path) -> None:
    """The ports of PiniponSelvagem/HLS_KV260_AXIS 7797b94, design_1_axis_0_0.xci, of Vitis HLS 2022.2."""
    (tmp_path / "copy.cpp").write_text(AXIS)
    (tmp_path / "sizes.h").write_text("#define WORD 32\n")
    info = load_hls(HlsSpec((tmp_path / "copy.cpp",)))
    stated = {"ap_clk": ("in", 1), "ap_rst_n": ("in", 1)}
    for name, there, back in (("strm_in", "in", "out"), ("strm_out", "out", "in")):
        stated |= {f"{name}_TVALID": (there, 1), f"{name}_TREADY": (back, 1), f"{name}_TDATA": (there, 64)}
        stated |= {f"{name}_TLAST": (there, 1), f"{name}_TKEEP": (there, 8), f"{name}_TSTRB": (there, 8)}
    assert {port.name: (port.direction.value, port.width) for port in info.ports} == stated
    assert [i.clock for i in info.interfaces] == ["ap_clk", "ap_clk"]


KERNEL = """\
void hbm_kernel(ap_uint<32> *maxi, const int size, unsigned pattern, int range) {
#pragma HLS INTERFACE m_axi port=maxi offset=slave bundle=gmem
#pragma HLS INTERFACE s_axilite port=maxi bundle=control
#pragma HLS INTERFACE s_axilite port=size bundle=control
#pragma HLS INTERFACE s_axilite port=pattern bundle=control
#pragma HLS INTERFACE s_axilite port=range bundle=control
#pragma HLS INTERFACE s_axilite port=return bundle=control
    for (int i = 0; i < size; i++) maxi[i] = pattern + range;
}
"""


def test_registers_of_cpp_lie_where_vitis_hls_put_them(tmp_path: Path) -> None:
    """xhbm_kernel_hw.h of yxd97/check_vitis (Vitis HLS 2022.1): maxi 0x10, size 0x1c, pattern 0x24, range 0x2c."""
    (tmp_path / "k.cpp").write_text(KERNEL)
    found = hls_registers(HlsSpec((tmp_path / "k.cpp",)), None)
    assert {name: register.offset for name, register in found.items()} == {
        "ap_ctrl": 0, "maxi_0": 0x10, "maxi_1": 0x14, "size": 0x1C, "pattern": 0x24, "range": 0x2C,
    }  # fmt: skip
    info = load_hls(HlsSpec((tmp_path / "k.cpp",)))
    assert {(i.name, i.protocol, i.mode.value) for i in info.interfaces} == {
        ("s_axi_control", "axi4lite", "slave"),
        ("m_axi_gmem", "axi4", "master"),
    }
    assert [irq.port for irq in info.interrupts] == ["interrupt"]
    assert next(port.width for port in info.ports if port.name == "s_axi_control_AWADDR") == 6


def test_outputs_of_cpp_have_a_register_that_is_read_only(tmp_path: Path) -> None:
    """xkernel_hw.h of ilbertt/FPGAcademyMLG: op at 0x10, res at 0x18 with its valid bit at 0x1c."""
    text = "void k(int op, int *res) {\n#pragma HLS INTERFACE s_axilite port=op\n"
    text += "#pragma HLS INTERFACE s_axilite port=res\n#pragma HLS INTERFACE s_axilite port=return\n  *res = op;\n}\n"
    (tmp_path / "k.cpp").write_text(text)
    found = hls_registers(HlsSpec((tmp_path / "k.cpp",)), "k")
    assert (found["op"].offset, found["res"].offset, found["res"].access.value) == (0x10, 0x18, "ro")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("packet> &strm_in", "mystery> &strm_in"), "argument strm_in: the width of its type"),
        (("to.write(from.read());", ""), "argument strm_in: whether the stream is read or written cannot be seen"),
        (("#pragma HLS INTERFACE axis port=strm_in\n", "#pragma HLS INTERFACE ap_fifo port=strm_in\n"), "mode=ap_fifo"),
    ],
)
def test_what_is_not_understood_of_cpp_is_refused_with_its_line(
    tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    (tmp_path / "copy.cpp").write_text(AXIS.replace(*change).replace('#include "sizes.h"', "#define WORD 32"))
    with pytest.raises(HdlError, match=said):
        load_hls(HlsSpec((tmp_path / "copy.cpp",)))


def hls_project(folder: Path) -> Path:
    (folder / "copy.cpp").write_text(AXIS)
    (folder / "sizes.h").write_text("#define WORD 32\n")
    assert begun(folder, str(folder / "copy.cpp")) == {"copy": {"hls": {"sources": ["copy.cpp"]}}}
    return folder / "build.yaml"


def test_init_takes_cpp_and_the_header_is_an_input_of_its_synthesis(tmp_path: Path) -> None:
    hls_project(tmp_path)
    listed = (tmp_path / "build/inputs/synth_copy.list").read_text().splitlines()
    assert {"../copy.cpp", "../sizes.h", "tcl/hls_copy.tcl"} <= set(listed)


def test_the_script_for_vitis_hls_has_known_commands_only(tmp_path: Path) -> None:
    pytest.importorskip("tclint", reason="needs tclint, which is not installed")
    hls_project(tmp_path)
    command = [sys.executable, "-m", "tclint", "--commands", str(TCL / "vitis_hls_commands.json"),
               "--style-line-length", "400", str(tmp_path / "build/tcl/hls_copy.tcl")]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@needs("tclsh")
def test_the_flow_runs_vitis_hls_and_makes_an_instance_of_what_it_exports(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path_factory.mktemp("flow") / "design"
    folder.mkdir()
    design = load_design(hls_project(folder))
    out = output_folder(design.project, None)
    generate(design, out)
    (tmp_path / "bin").mkdir()
    tool = tmp_path / "bin/vitis_hls"
    tool.write_text(
        "#!/bin/sh\nmkdir -p hls/copy/solution1/impl/ip && touch hls/copy/solution1/impl/ip/component.xml\n"
    )
    step = "tcl/step_synth_copy.tcl"
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    for earlier in scripts(out)[: scripts(out).index(step)]:
        assert replay(out, earlier, tmp_path)[0] == 0
    status, said, _ = replay(out, step, tmp_path)
    assert status == 1
    assert "Vitis HLS stopped at copy" in said
    tool.chmod(0o755)
    status, said, calls = replay(out, step, tmp_path)
    assert status == 0, said
    created = "create_ip -vendor xilinx.com -library hls -name copy -version 1.0 -module_name copy -dir hls/copy_ip"
    assert created in calls


def damaged(text: str) -> st.SearchStrategy[str]:
    """`text` with a piece removed, doubled, or inserted."""
    place = st.integers(0, len(text))
    noise = st.text(alphabet='(){}<>[];:,*&"#/\\? \nabc019=', max_size=12)
    return st.builds(lambda a, b, n: text[: min(a, b)] + n + text[max(a, b) :] * (1 + len(n) % 2), place, place, noise)


@given(damaged(AXIS.replace('#include "sizes.h"', "#define WORD 32") + KERNEL), st.sampled_from(["copy", "hbm_kernel"]))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_damage_of_cpp_is_read_or_refused(tmp_path: Path, text: str, top: str) -> None:
    (tmp_path / "k.cpp").write_text(text)
    with contextlib.suppress(HdlError):
        load_hls(HlsSpec((tmp_path / "k.cpp",)), top)
    with contextlib.suppress(HdlError):
        hls_registers(HlsSpec((tmp_path / "k.cpp",)), None)


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
