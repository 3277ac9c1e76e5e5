# SPDX-License-Identifier: Apache-2.0
"""The parts of the open flow that need none of its tools: what is refused, how sides are merged and checked."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.cli.main import main
from cm.design.errors import BuildError, MissingTool, StepFailed
from cm.design.generate.generation import load_design
from cm.design.openflow.images import outside, user_id
from cm.design.openflow.netlists import bits_of_region, module_side, open_system, open_top, static_side
from cm.design.openflow.place_and_route import Timing, read_timing, slacks
from cm.design.openflow.rewrites import packable, separate, unchain, with_contents
from cm.design.openflow.routed import read_routed
from cm.design.openflow.rules import check_cells, check_open
from cm.design.openflow.steps import OpenStepEndless, Steps, key_of, run_tool
from cm.design.openflow.synth import Sources, script
from cm.design.openflow.tools import Tool, find_tools
from cm.design.plan.dma_engines import EngineKind
from cm.design.plan.system import System
from cm.design.project.source_position import Finding
from cm.formats.xray import Feature

EXAMPLES = Path(__file__).resolve().parents[3] / "cm" / "data" / "examples"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    shutil.copytree(EXAMPLES / "camera", tmp_path / "camera")
    shutil.copytree(EXAMPLES / "open_camera", tmp_path / "open_camera")
    return tmp_path / "open_camera" / "build.yaml"


def changed(project: Path, *replacements: tuple[str, str]) -> System:
    text = project.read_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    project.write_text(text)
    return load_design(project).system


def messages(found: list[Finding]) -> str:
    return "\n".join(finding.text(Path("build.yaml")) for finding in found)


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"kind": EngineKind.VDMA}, "engine camera is one of PG020, which is the vendor's IP"),
        ({"kind": EngineKind.MCDMA}, "engine camera is one of PG288, which is the vendor's IP"),
        ({"width": 128}, "a stream of 128 bits: ports to memory have 64"),
    ],
)
def test_a_stream_that_the_engine_cannot_serve_is_reported_with_the_key_of_its_interface(
    project: Path, other: dict[str, Any], told: str
) -> None:
    system = load_design(project).system
    (region,) = system.regions
    streams = tuple(replace(bus, dma=replace(bus.dma, **other)) for bus in region.streams if bus.dma)
    found = messages(check_open(replace(system, regions=(replace(region, streams=streams),))))
    for interface in ("s_axis", "m_axis"):
        assert f"regions.prr0.interfaces.{interface}: {told}" in found


def test_more_streams_than_ports_to_memory_are_reported(project: Path) -> None:
    system = load_design(project).system
    (region,) = system.regions
    many = tuple(replace(region, streams=region.streams, index=number) for number in range(5))
    found = messages(check_open(replace(system, regions=many)))
    assert "5 streams from memory: the processing system has 4 ports for them" in found
    assert "5 streams to memory: the processing system has 4 ports for them" in found


def test_each_stream_has_half_a_port_to_memory_and_its_interrupt_line(project: Path) -> None:
    system = load_design(project).system
    top = open_top(system)
    assert [i.module for i in top.instances] == ["cm_axil_interconnect", "cm_axi_dma", "cm_open_system", "cm_static"]
    engine, processor = top.instances[1:3]
    assert engine.parameters["MM2S_BYTES"] == engine.parameters["S2MM_BYTES"] == 1
    assert engine.connections["m_axi_araddr"] == processor.connections["s_axi_hp0_araddr"] == "s_axi_hp0_araddr"
    assert engine.connections["m_axi_wdata"] == processor.connections["s_axi_hp0_wdata"]
    lines = dict(top.assigns)["irq_lines"].strip("{}").split(", ")[::-1]
    assert lines[:4] == ["irq", "irq_pictures", "irq_camera", "1'b0"]
    assert {dma.name: dma.line for dma in system.dmas} == {"pictures": 1, "camera": 2}
    (ps7,) = (i for i in open_system(system).instances if i.module == "PS7")
    assert ps7.connections["SAXIHP0ACLK"] == ps7.connections["MAXIGP0ACLK"] == "clk"
    assert not [pin for pin in ps7.connections if pin.startswith("SAXIHP1")]


def test_streams_at_pins_need_neither_engine_nor_port_to_memory(project: Path) -> None:
    pins = [
        ("s_axis: {stream: pictures, shape: [480, 640], slots: 4, engine: camera}",
         's_axis: {connect: external, pins: {tdata: "jc[0:7]", tvalid: "je[0]", tready: "je[1]", tlast: "je[2]"}}'),
        ("m_axis: {stream: camera, shape: [480, 640], slots: 8, engine: camera}",
         'm_axis: {connect: external, pins: {tdata: "jd[0:7]", tvalid: "je[3]", tready: "je[4]", tlast: "je[5]"}}'),
        (", streams: {camera: {shape: [480, 640, 3]}}", ""),
    ]  # fmt: skip
    system = changed(project, *pins)
    assert check_open(system) == []
    assert [i.module for i in open_top(system).instances] == ["cm_open_system", "cm_static"]
    (ps7,) = (i for i in open_system(system).instances if i.module == "PS7")
    assert not [pin for pin in ps7.connections if pin.startswith("SAXI")]


def test_check_says_which_tools_refuse(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changed(project, ("loader: fpga_manager", "loader: icap"))
    assert main(["build", "check", str(project)]) == 0
    assert main(["build", "check", "--flow", "open", str(project)]) == 1
    assert "refused by the open tools: " in capsys.readouterr().out


def test_cells_that_were_not_tried_are_named_before_placement() -> None:
    cells = {"inner.pll": {"type": "MMCME2_ADV"}, "a": {"type": "LUT6"}, "b": {"type": "RAMB18E1"}}
    with pytest.raises(BuildError, match=r"module x: 1 cells .*inner\.pll is a MMCME2_ADV"):
        check_cells({"modules": {"top": {"cells": cells}}}, "top", "module x")
    cells["inner.pll"] = {"type": "DSP48E1"}
    with pytest.raises(BuildError, match=r"module x: inner\.pll is a DSP48E1, and its region has none: add"):
        check_cells({"modules": {"top": {"cells": cells}}}, "top", "module x")
    check_cells({"modules": {"top": {"cells": cells}}}, "top", "module x", dsp=True)
    del cells["inner.pll"]
    check_cells({"modules": {"top": {"cells": cells}}}, "top", "module x")


def test_every_wire_of_a_boundary_but_its_clock_has_one_anchor_on_both_sides(project: Path) -> None:
    system = load_design(project).system
    (region,) = system.regions
    bits = bits_of_region(region)
    assert len(bits) == 131 - 1 + 32  # all but the clock, and the identity
    for net in (static_side(region), module_side(region)):
        anchors = [i for i in net.instances if i.name.startswith("cm_anchor_")]
        assert {a.name for a in anchors} == {f"cm_anchor_{bit.label}" for bit in bits}
        ends = {pin for a in anchors for pin in a.connections.values()}
        assert {bit.signal for bit in bits} <= ends
    into = {bit.port for bit in bits if bit.into}
    assert {"s_axis_tdata", "aresetn"} <= into
    assert "m_axis_tdata" not in into


def test_a_flip_flop_behind_an_anchor_gets_a_look_up_table_of_its_own() -> None:
    cells: dict[str, Any] = {
        "region.cm_anchor_0_1": {"type": "LUT1", "connections": {"I0": [2], "O": [3]}},
        "fed": {"type": "FDRE", "connections": {"D": [3], "Q": [4]}},
        "free": {"type": "FDRE", "connections": {"D": [4], "Q": [5]}},
    }
    netlist = {"modules": {"top": {"cells": cells, "netnames": {"n": {"bits": [2, 3, 4, 5, "x"]}}}}}
    assert separate(netlist, "top") == 1
    (added,) = (cell for name, cell in cells.items() if name.startswith("cm_pass"))
    assert added["connections"] == {"I0": [3], "O": [6]}
    assert cells["fed"]["connections"]["D"] == [6]
    assert cells["free"]["connections"]["D"] == [4]


def test_only_the_part_of_a_net_that_the_design_needs_is_kept(tmp_path: Path) -> None:
    """A net to a register of the design and to the harness: the route that only the harness needs is dropped."""
    nets = {
        "data": {
            "driver": "inner.reg",
            "users": [["inner.other", "D", "X1Y1/A"], ["cm_harness_0_1_lut", "A1", "X1Y1/B"]],
            "wires": {
                "X1Y1/A": ["X1Y1/A/M", "X1Y1/M"],
                "X1Y1/B": ["X1Y1/B/M", "X1Y1/M"],
                "X1Y1/M": ["X1Y1/M/S", "X1Y1/S"],
                "X1Y1/S": None,
            },
        },
        "toggle": {
            "driver": "cm_harness_0_toggle",
            "users": [["cm_anchor_0_2", "A1", "X1Y1/C"]],
            "wires": {"X1Y1/C": ["X1Y1/C/T", "X1Y1/T"], "X1Y1/T": None},
        },
    }
    path = tmp_path / "dump.json"
    path.write_text(json.dumps({"cells": {"a.cm_clock_buffer": ["BUFGCTRL", "X9Y9/B"]}, "nets": nets}))
    routed = read_routed(path, frozenset({"0_2"}))
    kept, dropped = routed.pips()
    assert {pip for pip, _ in kept} == {"X1Y1/A/M", "X1Y1/M/S"}
    assert {pip for pip, _ in dropped} == {"X1Y1/B/M", "X1Y1/C/T"}
    assert routed.place("cm_clock_buffer") == "X9Y9/B"


def test_inputs_of_look_up_tables_are_found_although_the_router_swapped_them(tmp_path: Path) -> None:
    """nextpnr renames the cell's pins after the slice's, and not the wires: pin A4 is reached over wire A1."""
    wires = {
        "X1Y1/SLICE_X0Y0.A1": ["X1Y1/SLICE_X0Y0.A1/CLBLL_LL_A4", "X1Y1/CLBLL_LL_A4"],
        "X1Y1/CLBLL_LL_A4": ["X1Y1/CLBLL_LL_A4/IMUX", "X1Y1/S"],
        "X1Y1/S": None,
    }
    users = [["lut", "A4", "X1Y1/SLICE_X0Y0.A4"], ["lost", "A2", "X1Y1/SLICE_X0Y0.B2"]]
    path = tmp_path / "dump.json"
    path.write_text(json.dumps({"cells": {}, "nets": {"n": {"driver": "reg", "users": users, "wires": wires}}}))
    routed = read_routed(path, frozenset())
    assert {pip for pip, _ in routed.pips()[0]} == {"X1Y1/SLICE_X0Y0.A1/CLBLL_LL_A4", "X1Y1/CLBLL_LL_A4/IMUX"}
    assert routed.lost() == ["net n does not reach pin A2 of lost"]


def report(tmp_path: Path, *paths: tuple[str, str, str, float]) -> Timing:
    nets = [
        {"event": f"posedge {start}", "endpoints": [{"event": f"posedge {end}", "cell": cell, "delay": [0, delay]}]}
        for start, end, cell, delay in paths
    ]
    fmax = {"clk": {"achieved": 100.0}, "x.cm_toggle_clock": {"achieved": 20.0}}
    (tmp_path / "report.json").write_text(json.dumps({"detailed_net_timings": nets, "fmax": fmax}))
    return read_timing(tmp_path / "report.json")


def test_paths_over_anchors_have_the_sum_of_both_sides(tmp_path: Path) -> None:
    harness = "x.cm_toggle_clock"
    static = report(tmp_path, ("clk", harness, "cm_harness_0_1_ff", 6.0), (harness, "clk", "reg", 3.0))
    module = report(
        tmp_path,
        ("clk", harness, "cm_harness_0_1_ff", 4.0),
        (harness, "clk", "reg", 5.0),
        (harness, harness, "cm_harness_0_toggle", 99.0),  # the harness's own
    )
    assert static == Timing(10.0, 6.0, 3.0, 0.0)
    left = slacks(static, module, 10.5)
    assert left["static part to module"] == pytest.approx(-0.5)
    assert left["module to static part"] == pytest.approx(3.5)
    assert left["module"] == pytest.approx(0.5)
    assert "static part through module" not in left


def test_frames_outside_the_columns_that_differ_are_reported() -> None:
    one, other = {0x1400: 1, 0x1380: 5}, {0x1400: 2, 0x1380: 5, 0x1A00: 4}
    assert outside([0x1400 >> 7], one, other) == [0x1A00]
    assert user_id(one) == user_id(dict(reversed(one.items()))) != user_id(other)


def test_a_step_is_left_out_where_its_input_is_the_same_and_its_output_there(tmp_path: Path) -> None:
    said: list[str] = []
    out, source = tmp_path / "out", tmp_path / "in"
    source.write_text("a")

    def once() -> list[str]:
        steps = Steps(tmp_path, said.append)
        steps.step("one", "a step", key_of(1, source), [out], lambda: out.write_text("x") and None)
        return steps.ran

    assert once() == ["one"]
    assert once() == []
    source.write_text("b")
    assert once() == ["one"]
    out.unlink()
    assert once() == ["one"]
    assert said[0] == "one: a step"


def test_a_step_that_fails_is_begun_anew(tmp_path: Path) -> None:
    def fail() -> None:
        raise StepFailed("no")

    steps = Steps(tmp_path, lambda _: None)
    steps.step("one", "a step", "key", [], lambda: None)
    with pytest.raises(StepFailed):
        steps.step("one", "a step", "other", [], fail)
    assert not steps.fresh("one", "key", [])


def test_a_program_that_fails_is_reported_with_its_errors_and_its_log(tmp_path: Path) -> None:
    shell = Tool("nextpnr", ("/bin/sh", "-c"))
    words = ["echo fine; echo 'ERROR: no place for cell x'; exit 3"]
    with pytest.raises(StepFailed, match=r"module m: nextpnr failed; .*log says:\n    ERROR: no place for cell x"):
        run_tool(shell, words, tmp_path / "log", {}, "module m")


def test_a_path_that_yosys_cannot_take_is_reported() -> None:
    with pytest.raises(BuildError, match="yosys takes no path with spaces"):
        script(Sources("top", (Path("/a folder/x.v"),)), Path("/out.json"), Path("/"))


def test_missing_tools_are_reported_with_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CM_XRAY_DATABASE", str(tmp_path / "none"))
    with pytest.raises(MissingTool) as told:
        find_tools(tmp_path / "nothing")
    assert str(told.value).count("cm build tools --fetch") == 3


def test_a_program_that_exceeds_its_processor_time_is_ended(tmp_path: Path) -> None:
    shell = Tool("nextpnr", ("/bin/sh", "-c"))
    with pytest.raises(OpenStepEndless, match="module m: nextpnr did not finish within 1 s of processor time"):
        run_tool(shell, ["while :; do :; done"], tmp_path / "log", {}, "module m", seconds=1)


def cell(kind: str, ports: dict[str, list[Any]], outputs: str, **parameters: str) -> dict[str, Any]:
    directions = {name: "output" if name in outputs.split() else "input" for name in ports}
    return {
        "type": kind, "parameters": parameters, "attributes": {}, "connections": ports, "port_directions": directions,
    }  # fmt: skip


def module_of(cells: dict[str, Any]) -> dict[str, Any]:
    return {"modules": {"top": {"cells": cells, "ports": {}, "netnames": {}}}}


def test_a_long_shift_register_goes_on_from_a_table_that_is_read_at_its_end() -> None:
    first = {"A": [3, 4, 5, 6, 7], "CE": [8], "CLK": [9], "D": [10], "Q": [11], "Q31": [12]}
    second = {"A": [3, 4, 5, 6, 7], "CE": [8], "CLK": [9], "D": [12], "Q": [13], "Q31": [14]}
    netlist = module_of(
        {"a": cell("SRLC32E", first, "Q Q31", INIT="1" * 32), "b": cell("SRLC32E", second, "Q Q31", INIT="0" * 32)}
    )
    assert unchain(netlist, "top") == 1
    cells = netlist["modules"]["top"]["cells"]
    assert not [name for name, one in cells.items() if "Q31" in one["connections"]]
    assert cells["a_cm_end"]["connections"] == {"A": ["1"] * 5, "CE": [8], "CLK": [9], "D": [10], "Q": [12]}
    assert cells["a_cm_end"]["parameters"] == cells["a"]["parameters"]


def test_memories_of_64_words_with_one_address_share_a_cell_and_keep_their_contents() -> None:
    names = "ABCDE"
    pins = {f"A{bit}": [bit] for bit in range(6)} | {"WE": [30], "WCLK": [31]}
    netlist = module_of(
        {
            name: cell("RAM64X1S", pins | {"D": [40 + at], "O": [50 + at]}, "O", INIT=f"{at + 1:064b}")
            for at, name in enumerate(names)
        }
    )
    packable(netlist, "top")
    cells = netlist["modules"]["top"]["cells"]
    assert {one["type"] for one in cells.values()} == {"RAM64M"}
    found = {
        (one["connections"][f"DI{letter}"][0], one["connections"][f"DO{letter}"][0], int(contents, 2))
        for one in cells.values()
        for letter in "ABCD"
        if f"DO{letter}" in one["connections"]
        for contents in {one["parameters"][f"INIT_{letter}"], one["parameters"][f"INIT{letter}"]}
    }
    assert found == {(40 + at, 50 + at, at + 1) for at in range(5)}
    assert all(one["connections"]["ADDRD"] == list(range(6)) for one in cells.values())


def test_a_memory_of_32_words_that_does_not_begin_with_zeros_becomes_two_that_keep_their_contents() -> None:
    words = [at * 7 % 4 for at in range(32)]  # two bits each
    contents = "".join(f"{word:02b}" for word in reversed(words))
    pins = {f"ADDR{letter}": list(range(5)) for letter in "ABCD"} | {f"DI{letter}": [20, 21] for letter in "ABCD"}
    pins |= {"DOA": [22, 23], "WE": [30], "WCLK": [31]}
    full = {"INIT_A": contents} | {f"INIT_{letter}": "0" * 64 for letter in "BCD"}
    netlist = module_of({"m": cell("RAM32M", pins, "DOA", **full)})
    packable(netlist, "top")
    cells = netlist["modules"]["top"]["cells"]
    by_output = {one["connections"]["DOA"][0]: int(one["parameters"]["INITA"], 2) for one in cells.values()}
    assert by_output == {22 + half: sum((word >> half & 1) << at for at, word in enumerate(words)) for half in range(2)}
    assert all(one["connections"]["ADDRA"] == [0, 1, 2, 3, 4, "0"] for one in cells.values())
    zeros = module_of({"m": cell("RAM32M", pins, "DOA", **dict.fromkeys(full, "0" * 64))})
    packable(zeros, "top")
    assert [one["type"] for one in zeros["modules"]["top"]["cells"].values()] == ["RAM32M"]


SLICES = SimpleNamespace(name="CLBLM_R_X3Y4", x=7, y=8, sites={"SLICE_X4Y4": "SLICEM", "SLICE_X5Y4": "SLICEL"})


@pytest.mark.parametrize(
    ("kind", "element", "init", "low"),
    [("SRL16E", "A6LUT", 0x8001, 32), ("SRL16E", "B5LUT", 0x0002, 0), ("SRLC32E", "C6LUT", 0x8000_0001, 0)],
)
def test_the_initial_bits_of_a_shift_register_occur_twice_in_its_look_up_table(
    kind: str, element: str, init: int, low: int
) -> None:
    length = 16 if kind == "SRL16E" else 32
    cells = {"s": {"type": kind, "parameters": {"INIT": f"{init:0{length}b}"}}}
    table = f"SLICEM_X0.{element[0]}LUT"
    wrong = {Feature(SLICES.name, f"{table}.INIT[{low + 1}]"), Feature(SLICES.name, f"{table}.INIT[{low + 7}]")}
    other = {Feature(SLICES.name, f"{table}.SRL"), Feature(SLICES.name, "SLICEM_X0.DLUT.INIT[0]")}
    database: Any = SimpleNamespace(tiles={SLICES.name: SLICES}, tile_at={(SLICES.x, SLICES.y): SLICES})
    found = with_contents(wrong | other, database, cells, {"s": ("SLICE_LUTX", f"X7Y8/SLICE_X0Y0.{element}")})
    ones = {low + 2 * bit + twice for bit in range(length) if init >> bit & 1 for twice in range(2)}
    assert found == other | {Feature(SLICES.name, f"{table}.INIT[{at}]") for at in ones}
