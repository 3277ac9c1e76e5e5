# SPDX-License-Identifier: Apache-2.0
"""What `cm build check` refuses in Vivado's place: pblocks, pins, clocks; correct designs pass."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from build_support import AXIL_MODULE, MINIMAL, STREAM_MODULE, copy_examples, project

from cm import schema
from cm.cli.main import main
from cm.design.boards import boards
from cm.design.check.block_design import check_block_design
from cm.design.check.rules import check_system
from cm.design.errors import BuildError
from cm.design.generate.generation import generate, load_design
from cm.design.generate.outputs import render_all
from cm.design.partition.utilisation import part_of
from cm.design.parts import device_of
from cm.design.plan.block_design import context
from cm.design.plan.floorplan import DEVICES, Rectangle, device_sites, rectangle
from cm.design.plan.system import System
from cm.design.project.load import load_project
from cm.design.runtime.answers import Answers
from cm.schema.clock_rates import PLL, rate_problem, rounded
from cm.schema.model import Clock

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

TWO = """\
project: {name: small, part: xc7z020clg400-1}
regions:
  a: {pblock: [SLICE_X26Y50:SLICE_X43Y99, RAMB36_X2Y10:RAMB36_X2Y19, RAMB18_X2Y20:RAMB18_X2Y39]}
  b: {pblock: [SLICE_X0Y0:SLICE_X21Y49]}
modules:
  one: {sources: [one.v], regions: [a], resources: {lut: 100}}
  two: {sources: [one.v], top: one, regions: [b]}
"""
EXTERNAL = MINIMAL.replace("{pblock: auto}", "{interfaces: {m_axis: {connect: external}}}")
PINNED = """\
project: {name: small, board: pynq-z2}
regions:
  prr0:
    interfaces:
      m_axis: {connect: external, pins: {tdata: "rpi[0:7]", tvalid: led, tready: btn, tlast: Y18}, iostandard: LVCMOS33}
modules:
  one: {sources: [one.v]}
"""


def found(folder: Path, text: str, **files: str) -> list[str]:
    """Rules and messages of the errors in a design."""
    system = load_design(project(folder, text, **files)).system
    return [f"{finding.rule}: {finding.message}" for finding in check_system(system) if finding.error]


def test_two_regions_that_are_apart_are_good(tmp_path: Path) -> None:
    assert found(tmp_path, TWO) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("SLICE_X0Y0:SLICE_X21Y49", "SLICE_X40Y90:SLICE_X45Y110", "overlap: SLICE_X26Y50:SLICE_X43Y99 lies on"),
        ("SLICE_X0Y0:SLICE_X21Y49", "RAMB18_X2Y30:RAMB18_X2Y31", "overlap: RAMB36_X2Y10:RAMB36_X2Y19 lies on"),
        ("SLICE_X0Y0:SLICE_X21Y49", "CLOCKREGION_X0Y1:CLOCKREGION_X1Y1", "lies on"),
        ("SLICE_X0Y0:SLICE_X21Y49", "SLICE_X0Y0:SLICE_X200Y49", "reaches beyond xc7z020"),
        ("SLICE_X0Y0:SLICE_X21Y49", "BUFGCTRL_X0Y0:BUFGCTRL_X0Y15", "UG909: BUFGCTRL sites cannot be reconfigured"),
    ],
)
def test_an_impossible_floorplan_is_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert any(said in text for text in found(tmp_path, TWO.replace(old, new)))


def test_slices_that_the_processor_takes_the_place_of_do_not_count() -> None:
    """The lower left of xc7z020 has slices in its lowest clock region only."""
    device = device_sites("xc7z020")
    assert device is not None
    assert device.count(Rectangle("SLICE", 0, 0, 9, 149)) == 10 * 50
    assert device_sites("xck26") is None


@pytest.mark.parametrize("name", json.loads(DEVICES.read_text())["devices"])
def test_the_sites_of_a_device_are_as_many_as_its_part_has(name: str) -> None:
    """Compares two independent sources: the site grid and the parts' table."""
    device, part = device_sites(name), part_of(name)
    assert device is not None
    whole = {kind: device.limits(kind) for kind in ("SLICE", "DSP48", "RAMB36")}
    counted = {kind: device.count(area) for kind, area in whole.items() if area}
    assert 4 * counted["SLICE"] == part.resources.lut
    assert (counted["RAMB36"], counted["DSP48"]) == (part.resources.bram, part.resources.dsp)


def test_a_port_of_the_top_without_a_pin_is_refused_by_generate(tmp_path: Path) -> None:
    design = load_design(project(tmp_path, EXTERNAL))
    with pytest.raises(BuildError, match=r"axis_prr0_m_axis_tdata.* has no pin") as caught:
        generate(design, tmp_path / "build")
    assert "DRC UCIO-1" in str(caught.value)
    assert not (tmp_path / "build").exists()


def test_pins_of_the_users_own_constraints_count(tmp_path: Path) -> None:
    path = project(tmp_path, EXTERNAL + "static: {constraints: [own.xdc]}\n")
    ports = "axis_prr0_m_axis_*"
    (tmp_path / "own.xdc").write_text(f"set_property PACKAGE_PIN Y18 [get_ports {{{ports}}}]\n")
    assert len(found_at(path)) == 4
    (tmp_path / "own.xdc").write_text(f"set_property -dict {{PACKAGE_PIN Y18 IOSTANDARD X}} [get_ports {{{ports}}}]\n")
    assert found_at(path) == []


def found_at(path: Path) -> list[str]:
    return [finding.message for finding in check_system(load_design(path).system) if finding.error]


def test_pins_by_the_boards_names_are_written_as_constraints(tmp_path: Path) -> None:
    source = STREAM_MODULE.format(name="one", high=7)
    text = PINNED.replace("tvalid: led", 'tvalid: "led[3]"').replace("tready: btn", 'tready: "btn[0]"')
    design = load_design(project(tmp_path, text, one=source))
    assert [f for f in check_system(design.system) if f.error] == []
    written = render_all(design.system, tmp_path / "build", Answers())
    wanted = "set_property -dict {PACKAGE_PIN M14 IOSTANDARD LVCMOS33} [get_ports {axis_prr0_m_axis_tvalid}]"
    assert wanted in written["constraints/pins.xdc"]
    assert (
        "PACKAGE_PIN V8 IOSTANDARD LVCMOS33} [get_ports {axis_prr0_m_axis_tdata[2]}]" in written["constraints/pins.xdc"]
    )
    assert "read_xdc constraints/pins.xdc" in written["tcl/step_static.tcl"]
    assert "set cm_board tul.com.tw:pynq-z2:part0:1.0" in written["tcl/settings.tcl"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rpi[0:7]", "rpi[0:6]", "has 8 bits, 7 pins are given"),
        ("rpi[0:7]", "rpi[0:40]", "rpi of TUL PYNQ-Z2 has 20 pins: rpi[0:19]"),
        ("rpi[0:7]", "gpio[0:7]", "has no pins 'gpio[0:7]'; there are"),
        ("tlast: Y18", "tlast: F19", "both on F19"),
        (", iostandard: LVCMOS33", "", "Y18 is a package pin: iostandard: must say its voltage"),
        ("tlast: Y18", "tlast: Y18, tuser: Y19", "m_axis has no tuser"),
    ],
)
def test_impossible_pins_are_reported(old: str, new: str, said: str, tmp_path: Path) -> None:
    text = PINNED.replace("tvalid: led", 'tvalid: "led[3]"').replace("tready: btn", 'tready: "btn[0]"')
    messages = found(tmp_path, text.replace(old, new), one=STREAM_MODULE.format(name="one", high=7))
    assert any(said in message for message in messages)


PHY = STREAM_MODULE.format(name="one", high=31).replace(
    "    input  wire        resetn,",
    "    input  wire        resetn,\n    input  wire        rx_clk,\n    input  wire [7:0] rxd,",
)


def test_a_second_clock_gets_what_the_build_schema_says(tmp_path: Path) -> None:
    clocks = "clocks: {fclk0: {rate: 100_000_000}, fclk1: {rate: 125_000_000}}\n"
    text = clocks + MINIMAL.replace("{pblock: auto}", "{clocks: {clk: fclk0, rx_clk: fclk1}}")
    design = load_design(project(tmp_path, text, one=PHY))
    assert [f for f in check_system(design.system) if f.error] == []
    static = render_all(design.system, tmp_path / "build", Answers())["hdl/cm_static.v"]
    assert "assign prr0_rx_clk = clk_fclk1;" in static
    assert "cm_sync #(" in static[static.index("rx_clk_resetn") :] or "sync_prr0_rx_clk_resetn" in static


def test_check_lists_clocks_and_resets_with_what_they_get(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "check", str(project(tmp_path, MINIMAL, one=PHY))]) == 1
    said = capsys.readouterr().out
    assert "rx_clk: clock → nothing says what drives it" in said
    assert "have a clock rx_clk beside the region's" in said
    assert "clk_resetn: reset, active low" in said


def block_design_of(folder: Path) -> tuple[System, dict[str, Any]]:
    system = load_design(project(folder, one=AXIL_MODULE)).system
    return system, context(system)


def spoil(found: dict[str, Any], what: str) -> None:
    """Put one mistake into a correct block design."""
    dma, segment, clock = found["dmas"][0], found["segments"][0], found["clocks"][0]
    if what == "length":
        found["dmas"][0] = replace(dma, settings=tuple((n, 27 if "length" in n else v) for n, v in dma.settings))
    elif what == "width":
        found["dmas"][0] = replace(dma, settings=tuple((n, 24 if "tdata" in n else v) for n, v in dma.settings))
    elif what == "narrow":
        found["dmas"][0] = replace(dma, settings=tuple((n, 64 if "tdata" in n else v) for n, v in dma.settings))
    elif what == "name":
        found["dmas"][0] = replace(dma, settings=(*dma.settings, ("c_include_sgg", 1)))
    elif what == "unassociated":
        found["clocks"][0] = replace(clock, buses=())
    elif what == "overlap":
        found["segments"].append(segment)
    elif what == "alignment":
        window = replace(segment.window, base=segment.window.base + 4)
        found["segments"][0] = replace(segment, window=window)
    elif what == "outside":
        found["segments"][0] = replace(segment, window=replace(segment.window, base=0x8000_0000))
    elif what == "fclk":
        found["ps_settings"].append(("PCW_FPGA0_PERIPHERAL_FREQMHZ", "300"))
    elif what == "ports":
        found["masters"] = ["x"] * 17
    elif what == "lines":
        found["interrupts"][0] = replace(found["interrupts"][0], sources=("x",) * 17)


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("length", "PG021: dma_icap: c_sg_length_width is 27 (it may be 8 to 26)"),
        ("width", "PG021: dma_icap: c_m_axis_mm2s_tdata_width is 24"),
        ("narrow", "PG021: dma_icap: the stream has 64 bits, the way to memory 32"),
        ("name", "PG021: dma_icap has no parameter c_include_sgg"),
        ("unassociated", "BD 41-967: axis_icap runs on fclk0, but is associated with no clock"),
        ("overlap", "address: domain_fclk0 and domain_fclk0 overlap at 0x40000000"),
        ("alignment", "address: domain_fclk0: 0x1000000 bytes at 0x40000004 (a range is a power of two"),
        ("outside", "address: domain_fclk0 at 0x80000000 is outside the window of M_AXI_GP0"),
        ("fclk", "PG082: PCW_FPGA0_PERIPHERAL_FREQMHZ is 300 MHz"),
        ("ports", "PG247: control_interconnect has 17 ports"),
        ("lines", "17 interrupts go to IRQ_F2P, which has 16 lines"),
    ],
)
def test_a_block_design_with_a_mistake_is_refused(what: str, said: str, tmp_path: Path) -> None:
    system, design = block_design_of(tmp_path)
    assert list(check_block_design(system, design)) == []
    spoil(design, what)
    told = [f"{f.rule}: {f.message}{f' ({f.hint})' if f.hint else ''}" for f in check_block_design(system, design)]
    assert any(said in text for text in told)


@pytest.mark.parametrize("name", boards())
def test_a_board_of_the_library_is_one_that_the_tool_can_build_for(name: str, tmp_path: Path) -> None:
    board = boards()[name]
    text = MINIMAL.replace("part: xc7z020clg400-1", f"board: {name}")
    assert load_project(project(tmp_path, text)).part == board.part
    assert part_of(device_of(board.part))
    pins = [pin.location for pins in board.connectors.values() for pin in pins]
    assert len(pins) == len(set(pins)) > 4
    assert all(pin.iostandard for pins in board.connectors.values() for pin in pins)
    assert "pins" in str(board.sources)
    assert all(rectangle(text) for ranges in board.pblocks.values() for text in ranges)


@pytest.mark.parametrize(("board", "pblock"), [(b.name, p) for b in boards().values() for p in b.pblocks])
def test_a_proven_pblock_is_one_that_the_rules_accept(board: str, pblock: str, tmp_path: Path) -> None:
    text = MINIMAL.replace("part: xc7z020clg400-1", f"board: {board}").replace("auto", f"'proven:{pblock}'")
    assert found(tmp_path, text) == []


@pytest.mark.parametrize("name", ["camera", "two_regions"])
def test_an_example_has_every_pin_and_a_place_for_all_its_modules(name: str, tmp_path: Path) -> None:
    assert found_at(copy_examples(tmp_path) / name / "build.yaml") == []


@pytest.mark.parametrize(
    ("part", "rate", "there"),
    [
        ("xc7z020clg400-1", 150_000_000, 142_857_141),
        ("xc7z020clg400-1", 142_857_141, None),
        ("xc7z020clg400-1", 143_000_000, None),  # within one percent
        ("xc7z020clg400-1", 142_857_143, None),  # a seventh of the PLL, which is a little below 1 GHz
        ("xc7z020clg400-1", 142_857_000, 142_857_141),  # would be an eighth: rates are rounded down
        ("xck26-sfvc784-2LV-c", 150_000_000, None),
        ("xck26-sfvc784-2LV-c", 200_000_000, 187_499_998),
    ],
)
def test_a_rate_that_the_manager_would_refuse_is_refused_before_the_flow(
    part: str, rate: int, there: int | None, tmp_path: Path
) -> None:
    clocks = f"clocks: {{spare: {{rate: 100_000_000}}, fast: {{rate: {rate}}}}}\n"
    text = clocks + MINIMAL.replace("{pblock: auto}", "{clock: fast}").replace("xc7z020clg400-1", part)
    wrong = [line for line in found(tmp_path, text) if line.startswith("rate: ")]
    family = PLL["7series" if part.startswith("xc7z") else "ultrascale+"]
    told = rate_problem(Clock("fast", rate), rounded(family, rate))  # as the manager asks
    assert bool(wrong) == bool(told) == (there is not None)
    if there is not None:
        assert told in wrong[0]
        path = tmp_path / "build.yaml"
        (line,) = [f.text(path) for f in check_system(load_design(path).system) if f.rule == "rate"]
        assert "build.yaml:1:" in line
        assert f"write rate: {there}" in line


VIDEO = STREAM_MODULE.format(name="one", high=31).replace(
    "s_axis_tlast,", "s_axis_tlast,\n    input wire s_axis_tuser,"
)


def test_a_tuser_that_nobody_drives_and_a_window_without_registers_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert "s_axis_tuser" in VIDEO
    path = project(tmp_path, MINIMAL, one=VIDEO)
    assert main(["build", "check", str(path)]) == 0
    assert "note: " in (said := capsys.readouterr().out)
    assert "s_axis has TUSER, which its DMA engine leaves at 0 (video that begins with it wants connect: vdma)" in said
    path = project(tmp_path, MINIMAL, one=AXIL_MODULE)
    assert main(["build", "check", str(path)]) == 0
    assert "no registers are known on s_axi: its window is the memory one_s_axi" in capsys.readouterr().out
    assert main(["build", "generate", str(path)]) == 0
    (memory,) = schema.load(tmp_path / "build/config/small.yaml").modules["one"].memories.values()
    assert (memory.name, memory.size, memory.region) == ("one_s_axi", 0x100, "prr0")  # of 8 address bits


WRONG = [
    (
        "part: xc7z020clg400-1",
        "part: xc7z021clg400-1",
        "1:24: project.part: xc7z021clg400-1: there is no",
    ),
    (
        "{pblock: auto}",
        "{resources: {lut: 400000}}",
        "3:22: regions.prr0.resources.lut: 400000 lut (xc7z020",
    ),
    ("[one.v]", "[one.v]\n    resources: {dsp: 400}", "modules.one.resources.dsp: 400 dsp (xc7z020 has 220)"),
    (
        "[one.v]",
        "[one.v]\n    registers: {far: {offset: 0x10000}}",
        "7:23: modules.one.registers.far.offset: far ends",
    ),
    (
        "[one.v]",
        "[one.v]\n    registers: {gain: {offset: 0, max: 9}}\nmodes:\n  m: {modules: [one], registers: {gain: 10}}",
        "9:35: modes.m.registers.gain: 10 is outside min and max of gain (0 to 9)",
    ),
    (
        "[one.v]",
        "[one.v]\n    registers: {gain: {offset: 0, fields: {low: {lsb: 0, width: 2, values: {much: 4}}}}}",
        "modules.one.registers.gain.fields.low.values.much: 0x4 does not fit 2 bits",
    ),
]


@pytest.mark.parametrize(("old", "new", "said"), WRONG)
def test_a_value_that_cannot_be_is_refused_at_its_line(
    old: str, new: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = project(tmp_path, MINIMAL.replace(old, new), one=AXIL_MODULE)
    assert main(["build", "check", str(path)]) == 1
    assert said in capsys.readouterr().err


TWICE = """\
project: {name: small, part: xc7z020clg400-1}
regions: {left: {}, right: {}}
modules:
  one:
    sources: [one.v]
    regions: [left, right]
    registers: {gain: {offset: 0}}
modes:
  left: {modules: {left: one}}
"""


def test_one_register_name_in_two_regions_of_a_mode_is_refused_at_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = project(tmp_path, TWICE, one=AXIL_MODULE)
    assert main(["build", "check", str(path)]) == 0
    path.write_text(f"{TWICE}  both: {{modules: {{left: one, right: one}}}}\n")
    for action in ("check", "generate"):
        capsys.readouterr()
        assert main(["build", action, str(path)]) == 1
        said = "".join(capsys.readouterr())
        assert "build.yaml:7:17: modules.one.registers.gain: register gain is elsewhere too" in said
        assert "a module is written twice, with register names of its own" in said


def test_paths_are_told_without_detours(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "sub").mkdir()
    project(tmp_path / "sub", MINIMAL.replace("[one.v]", "[.././sub/../one.v]"))
    (tmp_path / "one.v").write_text("module one (input clk, output real x); endmodule\n")
    assert main(["build", "check", str(tmp_path / "sub/../sub/./build.yaml")]) == 1
    said = "".join(capsys.readouterr())
    assert f"{tmp_path}/one.v" in said
    assert ".." not in said


def test_an_empty_module_below_the_top_is_told(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    text = STREAM_MODULE.format(name="one", high=31).replace("endmodule", "    fp_add adder (.y());\nendmodule")
    stub = "(* black_box *)\nmodule fp_add (input a, output y);\nendmodule\n"
    path = project(tmp_path, MINIMAL.replace("[one.v]", "[one.v, fp_add.v]"), one=text, fp_add=stub)
    assert main(["build", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert f"problem: {tmp_path}/fp_add.v:2: module fp_add has nothing inside: nothing drives its outputs" in said
    (tmp_path / "fp_add.v").write_text(stub.replace(");", ");\n    assign y = a;"))
    assert main(["build", "check", str(path)]) == 0
    assert "problem" not in capsys.readouterr().out
