# SPDX-License-Identifier: Apache-2.0
"""The system around the regions: addresses, connections, interrupts, wrappers."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from build_support import AXIL_MODULE, MINIMAL, STREAM_MODULE, copy_examples, generated, project

from cm import schema
from cm.cli.main import main
from cm.design.boundary.analyse import analyse
from cm.design.errors import BuildError
from cm.design.generate.generation import Design, generate, load_design
from cm.design.generate.outputs import render_all
from cm.design.parts import device_of
from cm.design.platforms import ZYNQ7000, ZYNQMP
from cm.design.project.load import load_project
from cm.design.runtime.answers import Answers

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

MASTER = """\
module one (
    input  wire        clk,
    input  wire        rst,
    output wire [31:0] m_axi_awaddr,
    output wire [7:0]  m_axi_awlen,
    output wire        m_axi_awvalid,
    input  wire        m_axi_awready,
    output wire [63:0] m_axi_wdata,
    output wire [7:0]  m_axi_wstrb,
    output wire        m_axi_wlast,
    output wire        m_axi_wvalid,
    input  wire        m_axi_wready,
    input  wire [1:0]  m_axi_bresp,
    input  wire        m_axi_bvalid,
    output wire        m_axi_bready,
    output wire [31:0] m_axi_araddr,
    output wire [7:0]  m_axi_arlen,
    output wire        m_axi_arvalid,
    input  wire        m_axi_arready,
    input  wire [63:0] m_axi_rdata,
    input  wire [1:0]  m_axi_rresp,
    input  wire        m_axi_rlast,
    input  wire        m_axi_rvalid,
    output wire        m_axi_rready
);
endmodule
"""


def design(folder: Path, text: str = MINIMAL, **files: str) -> Design:
    return load_design(project(folder, text, **files))


def files(found: Design) -> dict[str, str]:
    return render_all(found.system, found.project.folder / "build", Answers())


def test_windows_never_overlap_and_are_aligned(tmp_path: Path) -> None:
    for name in ("camera", "two_regions"):
        system = (
            generated(copy_examples(tmp_path / name), name)[0].system if (tmp_path / name).mkdir() is None else None
        )
        assert system is not None
        windows = [window for domain in system.domains for window in domain.windows]
        windows += [dma.window for dma in system.dmas]
        ordered = sorted(windows, key=lambda window: window.base)
        assert all(window.base % window.size == 0 for window in ordered)
        assert all(one.end <= other.base for one, other in pairwise(ordered))
        limit = system.platform.base + system.platform.size
        assert all(system.platform.base <= window.base and window.end <= limit for window in ordered)
        for domain in system.domains:
            assert all(domain.aperture.base <= w.base and w.end <= domain.aperture.end for w in domain.windows)


def test_a_region_keeps_its_window_when_another_one_gets_modules(tmp_path: Path) -> None:
    def bases(folder: Path, more: str) -> dict[str, int]:
        folder.mkdir()
        modules = (
            "modules:\n  one: {sources: [one.v], regions: [a]}\n  two: {sources: [one.v], top: one, regions: [b]}\n"
        )
        text = MINIMAL.partition("regions:")[0] + f"regions: {{a: {{}}, b: {{}}}}\n{modules}{more}"
        system = design(folder, text, one=AXIL_MODULE).system
        return {bus.window.name: bus.window.base for region in system.regions for bus in region.registers}

    before = bases(tmp_path / "before", "")
    assert bases(tmp_path / "after", "  three: {sources: [one.v], top: one, regions: [a]}\n") == before


def test_a_module_may_go_to_several_regions(tmp_path: Path) -> None:
    text = MINIMAL.replace("  prr0: {pblock: auto}", "  prr0: {}\n  prr1: {}") + "    regions: [prr0, prr1]\n"
    found = design(tmp_path, text)
    generate(found, tmp_path / "build")
    config = schema.load(tmp_path / "build/config/small.yaml")
    assert {name: module.region for name, module in config.modules.items()} == {"one_prr0": "prr0", "one_prr1": "prr1"}
    assert len(found.system.runs) == 1
    assert len({one.identity for one in found.system.implementations}) == 2


def test_the_same_top_with_other_parameters_is_another_module(tmp_path: Path) -> None:
    source = STREAM_MODULE.format(name="one", high=31).replace("module one (", "module one #(parameter GAIN = 1) (")
    text = MINIMAL + "  two: {top: one, sources: [one.v], parameters: {GAIN: 7}}\n"
    written = files(design(tmp_path, text, one=source))
    assert ".GAIN(7)" in written["wrappers/two/cm_region_prr0.v"]
    assert ".GAIN" not in written["wrappers/one/cm_region_prr0.v"]


def test_a_master_goes_to_memory_and_its_high_reset_is_inverted(tmp_path: Path) -> None:
    written = files(design(tmp_path, one=MASTER))
    assert "cm_axi_master_decoupler" in written["hdl/cm_static.v"]
    assert ".rst(~aresetn)" in written["wrappers/one/cm_region_prr0.v"]
    assert "s_axi_prr0_m_axi" in written["tcl/block_design.tcl"]
    # the module does not choose the burst's size: whole beats of 64 bits
    assert ".s_axi_prr0_m_axi_awsize(3'd3)" in written["hdl/cm_top.v"]


def test_a_wide_register_interface_goes_to_the_processors_port(tmp_path: Path) -> None:
    wide = AXIL_MODULE.replace("[31:0] s_axi_wdata", "[63:0] s_axi_wdata").replace(
        "[31:0] s_axi_rdata", "[63:0] s_axi_rdata"
    )
    found = design(tmp_path, one=wide.replace("[3:0]  s_axi_wstrb", "[7:0]  s_axi_wstrb"))
    (bus,) = found.system.regions[0].registers
    assert bus.full
    assert bus.window.base == ZYNQ7000.base + 0x0800_0000


def test_a_stream_of_24_bits_gets_a_dma_of_32_and_a_converter(tmp_path: Path) -> None:
    found = design(tmp_path, one=STREAM_MODULE.format(name="one", high=23))
    static = files(found)["hdl/cm_static.v"]
    assert "output wire [31:0] axis_prr0_m_axis_tdata" in static
    assert static.count("cm_axis_width #(") == 2
    assert "CONFIG.HAS_TKEEP {1}" in files(found)["tcl/block_design.tcl"]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("shape: [4, 5]", "20 bytes: not a whole number of beats of 3 bytes"),
        ("shape: [4, 5], dtype: uint16", "4×5 uint16 has 40 bytes: not a whole number"),
        ("shape: [10, 3], max_length: 16", "30 bytes, max_length allows 16"),
    ],
)
def test_frames_must_be_what_the_stream_can_carry(keys: str, said: str, tmp_path: Path) -> None:
    text = MINIMAL.replace("{pblock: auto}", f"{{interfaces: {{m_axis: {{{keys}}}}}}}")
    with pytest.raises(BuildError, match=r"build.yaml:3:\d+") as caught:
        design(tmp_path, text, one=STREAM_MODULE.format(name="one", high=23))
    assert said in str(caught.value)


def test_the_frames_of_a_mode_are_checked_too(tmp_path: Path) -> None:
    text = MINIMAL.replace("{pblock: auto}", "{interfaces: {m_axis: {shape: [4, 3]}}}")
    text += "modes: {only: {modules: [one], streams: {prr0_m_axis: {shape: [4]}}}}\n"
    with pytest.raises(BuildError, match=r"modes.only.streams.prr0_m_axis"):
        design(tmp_path, text, one=STREAM_MODULE.format(name="one", high=23))


def test_a_stream_can_be_left_to_the_top(tmp_path: Path) -> None:
    text = MINIMAL.replace("{pblock: auto}", "{interfaces: {m_axis: {connect: external}}}")
    found = design(tmp_path, text)
    assert [dma.name for dma in found.system.dmas] == ["icap", "prr0_s_axis"]
    assert "output wire axis_prr0_m_axis_tvalid" in files(found)["hdl/cm_top.v"]


def test_without_an_icap_loader_there_is_no_icap(tmp_path: Path) -> None:
    found = design(tmp_path, MINIMAL.replace("{pblock: auto}", "{loader: fpga_manager}"))
    assert found.system.icap is None
    written = files(found)
    assert "cm_icap" not in written["hdl/cm_static.v"].replace("icap_status", "").replace("icap_words", "")
    assert "fpga-mgr = <&devcfg>;" in written["dts/small_static.dtso"]


def test_a_region_without_decoupling_is_reported_in_the_schema(tmp_path: Path) -> None:
    written = files(design(tmp_path, MINIMAL.replace("{pblock: auto}", "{decoupling: false}")))
    assert "# not decoupled: a load may disturb what is connected to it" in written["config/small.yaml"]
    assert "assign prr0_cut = 1'b0;" in written["hdl/cm_static.v"]


def test_more_masters_than_the_ports_to_memory_take_are_refused(tmp_path: Path) -> None:
    regions = ", ".join(f"r{index}: {{}}" for index in range(17))
    text = MINIMAL.replace("  prr0: {pblock: auto}", f"  {{{regions}}}")
    names = ", ".join(f"r{index}" for index in range(17))
    with pytest.raises(BuildError, match=r"70 masters to memory .* let streams share an engine"):
        files(design(tmp_path, text + f"    regions: [{names}]\n"))


def test_modules_that_do_not_fit_are_refused_by_name(tmp_path: Path) -> None:
    path = project(tmp_path, MINIMAL + "  two: {sources: [two.v]}\n", two=STREAM_MODULE.format(name="two", high=7))
    with pytest.raises(BuildError, match="modules that do not fit their region"):
        load_design(path)
    found = load_project(path)
    assert analyse(found).refused


def test_a_module_in_no_mode_is_noted(tmp_path: Path) -> None:
    text = MINIMAL + "  two: {top: one, sources: [one.v]}\nmodes: {m: {modules: [one]}}\n"
    notes = design(tmp_path, text).system.notes
    assert any("two in prr0 is in no mode" in note for note in notes)


def test_hdl_names_that_need_care_reach_tcl_whole(tmp_path: Path) -> None:
    folder = tmp_path / "a [b] $c"
    folder.mkdir()
    found = design(
        folder, MINIMAL.replace("one.v", "my file.v"), **{"my file": STREAM_MODULE.format(name="one", high=31)}
    )
    assert 'read_verilog "$cm_source/my file.v"' in files(found)["tcl/step_synth_one.tcl"]


def test_interrupt_lines_of_the_processors() -> None:
    assert [ZYNQ7000.spi(line) for line in (0, 7, 8, 15)] == [29, 36, 52, 59]
    assert [ZYNQMP.spi(line) for line in (0, 7, 8, 15)] == [89, 96, 104, 111]
    with pytest.raises(BuildError, match="16 interrupt lines"):
        ZYNQMP.spi(16)


@pytest.mark.parametrize(
    ("part", "device"),
    [("xc7z020clg400-1", "xc7z020"), ("xc7z007sclg225-1", "xc7z007s"), ("xck26-sfvc784-2LV-c", "xck26"),
     ("xczu3eg-sbva484-1-e", "xczu3eg"), ("xczu7ev-ffvc1156-2-e", "xczu7ev")],
)  # fmt: skip
def test_the_device_of_a_part(part: str, device: str) -> None:
    assert device_of(part) == device


HDL = Path(__file__).parents[2] / "data" / "hdl"


def with_component(folder: Path, module: str) -> Path:
    for name in ("tagged.v", "tagged.xml"):
        (folder / name).write_text((HDL / name).read_text())
    (folder / "tagged.xci").write_text("{}\n")
    return project(folder, MINIMAL.replace("    sources: [one.v]\n", module))


def test_the_extraction_is_compared_with_ip_xact(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = with_component(tmp_path, "    top: tagged\n    sources: [tagged.v]\n    component: tagged.xml\n")
    path.write_text(path.read_text().replace("{pblock: auto}", "{interfaces: {sensor: {connect: none}}}"))
    assert main(["build", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert f"differs from {tmp_path / 'tagged.xml'}" in said


def test_vendor_ip_is_taken_from_its_component_and_synthesised_as_ip(tmp_path: Path) -> None:
    path = with_component(tmp_path, "    top: tagged_ip\n    ip: [tagged.xci]\n    component: tagged.xml\n")
    found = load_design(path)
    written = files(found)
    assert {bus.interface.name for bus in found.system.regions[0].streams} >= {"pixels_in"}
    assert "tagged_ip inner (" in written["wrappers/one/cm_region_prr0.v"]
    step = written["tcl/step_synth_one.tcl"]
    assert 'read_ip "$cm_source/tagged.xci"\ngenerate_target all [get_ips]\nsynth_ip [get_ips]' in step
    assert "../tagged.xci" in written["inputs/synth_one.list"]


def test_two_modules_may_have_one_top_with_other_parameters_or_other_sources(tmp_path: Path) -> None:
    """Wrappers keep each its own, and so do the region's adaptations."""
    plain = STREAM_MODULE.format(name="one", high=31)
    (tmp_path / "more").mkdir()
    (tmp_path / "more/one.v").write_text(plain.replace("clk,", "clk,\n    output wire irq,", 1))
    stages = plain.replace("module one", "module one #(parameter STAGES = 1)")
    text = MINIMAL + (
        "  deep: {top: one, sources: [one.v], parameters: {STAGES: 4}}\n  loud: {top: one, sources: [more/one.v]}\n"
    )
    design = load_design(project(tmp_path, text, one=stages))
    (found,) = design.analysis.boundaries.values()
    assert [adaptation.module for adaptation in found.adaptations] == ["one", "deep", "loud"]
    out = tmp_path / "out"
    generate(design, out)
    texts = {path.parent.name: path.read_text().replace(" ", "") for path in out.glob("wrappers/*/*.v")}
    assert {name: ".STAGES(4)" in body for name, body in texts.items()} == {"one": False, "deep": True, "loud": False}
    assert {name: ".irq(" in body for name, body in texts.items()} == {"one": False, "deep": False, "loud": True}


def test_a_submodule_that_no_file_has_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    below = STREAM_MODULE.format(name="one", high=31).replace(
        "endmodule",
        "    helper h ();\n    BUFG b ();\n    xpm_cdc_single x ();\nendmodule\n"
        "module helper;\n    gone g ();\nendmodule",
    )
    path = project(tmp_path, one=below)
    assert main(["build", "check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "1 problem that synthesis will stop at" in said
    assert "no file has gone, which one needs below it" in said
    assert "BUFG" not in said
    path.write_text(path.read_text().replace("[one.v]", "[one.v, gone.v]"))
    (tmp_path / "gone.v").write_text("module gone;\nendmodule\n")
    assert main(["build", "check", str(path)]) == 0
    assert "no file has" not in capsys.readouterr().out


def test_a_signal_that_axi4_lite_does_not_have_is_driven_0(tmp_path: Path) -> None:
    """Some AXI4-Lite slaves have AWCACHE all the same."""
    extra = "    input  wire [3:0]  s_axi_awcache,\n    input  wire        s_axi_awvalid,\n"
    text = AXIL_MODULE.replace("    input  wire        s_axi_awvalid,\n", extra)
    assert text != AXIL_MODULE
    static = files(design(tmp_path, one=text))["hdl/cm_static.v"]
    assert "s_awpayload" in static
    assert "{4{1'b0}}" in static


def test_a_port_that_can_be_read_has_a_channel_back(tmp_path: Path) -> None:
    before = design(tmp_path, MINIMAL)
    found = design(tmp_path, MINIMAL + "static: {readback: true}\n")
    dmas = [(dma.name, dma.engine or dma.name, dma.line) for dma in found.system.dmas[:2]]
    assert dmas == [("icap", "icap", 1), ("icap_read", "icap", 2)]
    written = files(found)
    assert "cm_icap_read #(" in written["hdl/cm_static.v"]
    assert "hdl/lib/cm_icap_read.v" in written
    assert "Slave -vlnv xilinx.com:interface:axis_rtl:1.0 axis_icap_read" in written["tcl/block_design.tcl"]
    assert "dmas = <&cm_dma_icap 0>, <&cm_dma_icap 1>;" in written["dts/small_static.dtso"]
    assert 'dma-names = "icap", "rx";' in written["dts/small_static.dtso"]
    assert "icap_read" not in written["config/small.yaml"]
    # nothing of it is in a design that does not ask for it
    assert not [name for name, text in files(before).items() if "icap_read" in name + text]


def test_what_is_not_loaded_through_the_port_cannot_be_read_through_it(tmp_path: Path) -> None:
    text = MINIMAL.replace("{pblock: auto}", "{loader: fpga_manager}") + "static: {readback: true}\n"
    with pytest.raises(BuildError, match=r"static\.readback.*nothing that could be read back"):
        design(tmp_path, text)
