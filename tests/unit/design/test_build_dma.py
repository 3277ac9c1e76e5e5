# SPDX-License-Identifier: Apache-2.0
"""Streams that share DMA engines: two channels of an AXI DMA, MCDMA, VDMA, and more channels than interrupt lines."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from build_support import MINIMAL, STREAM_MODULE, needs, project
from test_build_overlays import DTS, apply, compile_tree, fdtget
from test_build_tcl import replay, scripts

from cm import schema
from cm.design.check.block_design import check_block_design
from cm.design.check.rules import check_system
from cm.design.collect.collected import QUIET
from cm.design.errors import BuildError
from cm.design.generate.generation import Design, generate, load_design, output_folder
from cm.design.plan.block_design import context
from cm.design.plan.dma_engines import EngineKind
from cm.schema import SchemaError

ONE_TO = "    regions: [{}]\n"
VIDEO = (
    STREAM_MODULE.format(name="one", high=23)
    .replace("s_axis_tlast,", "s_axis_tlast,\n    input wire [1:0] s_axis_tuser,", 1)
    .replace("output wire        m_axis_tlast", "output wire        m_axis_tlast,\n    output wire [1:0] m_axis_tuser")
    .replace("endmodule", "    assign m_axis_tuser = s_axis_tuser;\nendmodule")
)


def regions_of(count: int, engine: Callable[[int], str], part: str = "xc7z020clg400-1") -> str:
    """A build schema of `count` looped regions; `engine` names the engine of each."""
    ends = "s_axis: {{engine: {0}}}, m_axis: {{engine: {0}}}"
    listed = [f"r{i}: {{interfaces: {{{ends.format(engine(i))}}}}}" for i in range(count)]
    text = MINIMAL.replace("  prr0: {pblock: auto}", f"  {{{', '.join(listed)}}}").replace("xc7z020clg400-1", part)
    return text + ONE_TO.format(", ".join(f"r{i}" for i in range(count)))


APART = MINIMAL.replace("  prr0: {pblock: auto}", "\n".join(f"  r{i}: {{}}" for i in range(12)))
DESIGNS = {
    "twelve regions with engines of their own": APART + ONE_TO.format(", ".join(f"r{i}" for i in range(12))),
    "two regions with both channels of an engine": regions_of(2, lambda i: f"loop{i}"),
    "ten regions on an MCDMA": regions_of(10, lambda i: "all"),
    "thirty-two regions on two MCDMAs": regions_of(32, lambda i: f"half{i // 16}", "xck26-sfvc784-2LV-c"),
    "video": MINIMAL.replace(
        "{pblock: auto}",
        "{interfaces: {s_axis: {connect: vdma, shape: [480, 640, 3], engine: screen},"
        " m_axis: {connect: vdma, shape: [480, 640, 3], engine: screen}}}",
    ),
}


def built(folder: Path, name: str) -> tuple[Design, Path]:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    folder.mkdir(exist_ok=True)
    source = VIDEO if name == "video" else STREAM_MODULE.format(name="one", high=31)
    design = load_design(project(folder, DESIGNS[name], one=source))
    out = output_folder(design.project, None)
    generate(design, out)
    return design, out


@pytest.fixture(scope="module", params=DESIGNS)
def design(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Design, Path]:
    return built(tmp_path_factory.mktemp("dma") / "p", request.param)


@needs("tclsh")
def test_designs_of_shared_engines_replay_without_a_refusal(design: tuple[Design, Path], tmp_path: Path) -> None:
    out = design[1]
    status, said, calls = replay(out, scripts(out)[0], tmp_path)
    assert status == 0, said
    assert "WARNING" not in said
    assert calls


def test_every_stream_of_the_runtime_schema_has_a_channel_and_a_line(design: tuple[Design, Path]) -> None:
    system, out = design[0].system, design[1]
    config = schema.load(out / f"config/{system.project.name}.yaml")
    channels = {dma.name: dma for dma in system.dmas}
    assert set(config.streams) == set(channels) - {"icap"}
    assert all(1 <= dma.line < system.platform.irq_count for dma in channels.values())
    assert [dma.name for dma in system.dmas if dma.line == 1] == ["icap"]
    windows = [engine.window.base for engine in system.engines]
    assert len(set(windows)) == len(windows)
    assert [finding for finding in check_system(system) if finding.error] == []


def merged(design: tuple[Design, Path], folder: Path) -> Path:
    """The board's tree with the static part's overlay applied."""
    system, out = design[0].system, design[1]
    board = "zynq-7000" if system.platform.name == "zynq7000" else "kv260"
    flat = ["cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", "-I", str(DTS / "boards"), "-P"]
    subprocess.run([*flat, str(DTS / "boards" / f"{board}.dts"), str(folder / "board.dts")], check=True)
    compile_tree(folder / "board.dts", folder / "base.dtb", "-Wno-unit_address_vs_reg")
    compile_tree(out / f"dts/{system.project.name}_static.dtso", folder / "static.dtbo", *QUIET)
    return apply(folder / "base.dtb", folder / "static.dtbo")


@needs("dtc")
@needs("fdtoverlay")
@needs("cpp")
def test_the_tree_is_what_the_bindings_allow(design: tuple[Design, Path], tmp_path: Path) -> None:
    tool = Path(sysconfig.get_path("scripts")) / "dt-validate"
    if not tool.exists():
        pytest.skip("needs the PyPI package dtschema")
    tree = merged(design, tmp_path)
    whole = tree.with_suffix(".merged.dtb")
    tree.rename(whole)
    command = [sys.executable, str(tool), "-s", str(DTS / "bindings"), str(whole)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not [line for line in (done.stdout + done.stderr).splitlines() if str(whole) in line]
    assert done.returncode == 0, done.stdout + done.stderr


@needs("dtc")
@needs("fdtoverlay")
@needs("cpp")
def test_the_overlay_names_each_channel_as_the_kernels_driver_counts_them(
    design: tuple[Design, Path], tmp_path: Path
) -> None:
    """xilinx_dma: MM2S from 0; S2MM from 1 of an AXI DMA and VDMA, from 16 of an MCDMA; an interrupt each."""
    system = design[0].system
    tree = merged(design, tmp_path)
    nodes = sorted(node for node in fdtget(tree, "-l", "/") if node.startswith("cm-streams"))
    names = [name for node in nodes for name in fdtget(tree, f"/{node}", "dma-names")]
    numbers = [int(word) for node in nodes for word in fdtget(tree, f"/{node}", "dmas")[1::2]]
    streams = [dma for dma in system.dmas if dma.name != "icap"]
    assert names == [dma.name for dma in streams]
    first = {EngineKind.MCDMA: 16, EngineKind.DMA: 1, EngineKind.VDMA: 1}
    assert numbers == [dma.number + (0 if dma.sends else first[dma.kind]) for dma in streams]
    for engine in system.engines:
        node = f"/dma-controller@{engine.window.base:x}"
        children = {}
        for child in fdtget(tree, "-l", node):
            (kind,) = fdtget(tree, f"{node}/{child}", "compatible")
            children[kind.split("-")[-2]] = [int(spi) for spi in fdtget(tree, f"{node}/{child}", "interrupts")[1::3]]
        lines = {way.value: [system.platform.spi(dma.line) for dma in engine.of(way)] for way in engine.directions}
        assert children == lines
        if engine.kind is EngineKind.VDMA:  # else a frame of another size ends the channel
            assert fdtget(tree, node, "xlnx,flush-fsync") == ["1"]


def test_channels_that_share_lines_are_noted(tmp_path: Path) -> None:
    notes = built(tmp_path, "twelve regions with engines of their own")[0].system.notes
    assert any("24 DMA channels share 14 of the 16 interrupt lines" in note for note in notes)


def test_engines_are_what_their_streams_need(tmp_path: Path) -> None:
    kinds = {}
    for number, name in enumerate(DESIGNS):
        system = built(tmp_path / str(number), name)[0].system
        kinds[name] = {engine.kind.value for engine in system.engines if engine.name != "icap"}
    assert list(kinds.values()) == [{"axi_dma"}, {"axi_dma"}, {"axi_mcdma"}, {"axi_mcdma"}, {"axi_vdma"}]


def test_the_configuration_port_has_a_way_to_memory_of_its_own(tmp_path: Path) -> None:
    system = built(tmp_path, "ten regions on an MCDMA")[0].system
    memories = context(system)["memories"]
    assert [(memory.port.slave, len(memory.sources)) for memory in memories] == [("S_AXI_HP0", 3), ("S_AXI_HP3", 2)]
    assert all("dma_icap" in source for source in memories[-1].sources)


def test_streams_of_several_widths_share_an_engine_of_the_widest(tmp_path: Path) -> None:
    text = regions_of(2, lambda i: "all").replace("regions: [r0, r1]", "regions: [r0]")
    text += "  two: {sources: [two.v], regions: [r1]}\n"
    two = STREAM_MODULE.format(name="two", high=7)
    system = load_design(project(tmp_path, text, two=two)).system
    assert {dma.width for dma in system.dmas if dma.name != "icap"} == {32}
    assert [bus.converted for region in system.regions for bus in region.streams] == [False, False, True, True]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (regions_of(17, lambda i: "all", "xck26-sfvc784-2LV-c"), "engine all has 17 streams of one direction"),
        (
            regions_of(2, lambda i: "all").replace("r1: {", "r1: {clock: slow, ")
            + "clocks: {fclk0: {rate: 100_000_000}, slow: {rate: 50_000_000}}\n",
            "engine all has streams on fclk0 and slow: streams of one engine run on one clock",
        ),
        (MINIMAL.replace("{pblock: auto}", "{interfaces: {m_axis: {connect: vdma, shape: [2, 2]}}}"), "needs TUSER"),
        (MINIMAL.replace("{pblock: auto}", "{interfaces: {s_axis: {connect: vdma}}}"), "frames have lines and columns"),
        (
            MINIMAL.replace("{pblock: auto}", "{interfaces: {s_axis: {connect: vdma, shape: [480, 3]}}}"),
            "a line has 3 bytes: a VDMA's lines are multiples of 4 bytes here",
        ),
        (
            MINIMAL.replace("{pblock: auto}", "{interfaces: {s_axis: {connect: vdma, shape: [9000, 4]}}}"),
            "9_000 lines of 4 bytes: a VDMA takes 8191 lines",
        ),
        (
            MINIMAL.replace(
                "{pblock: auto}",
                "{interfaces: {s_axis: {connect: vdma, shape: [2, 4], engine: x}, m_axis: {engine: x}}}",
            ),
            "engine x has video and other streams",
        ),
        (
            MINIMAL.replace("{pblock: auto}", "{interfaces: {s_axis: {engine: icap}}}"),
            "engine icap is the configuration port's",
        ),
    ],
)
def test_streams_that_cannot_share_an_engine_are_refused_with_their_place(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises((BuildError, SchemaError)) as caught:
        load_design(project(tmp_path, text))
    message = str(caught.value).replace(" (", ": ").replace(")", "")
    assert said in message
    assert "build.yaml:" in message


def test_a_stream_without_an_end_cannot_take_turns(tmp_path: Path) -> None:
    source = STREAM_MODULE.format(name="one", high=31).replace("    assign m_axis_tlast = s_axis_tlast;\n", "")
    source = source.replace(",\n    output wire        m_axis_tlast", "")
    with pytest.raises(BuildError, match=r"r0\.m_axis, which has no TLAST"):
        load_design(project(tmp_path, regions_of(2, lambda i: "all"), one=source))


@pytest.mark.parametrize(
    ("name", "setting", "value", "said"),
    [
        ("ten regions on an MCDMA", "c_num_mm2s_channels", 17, "PG288: dma_all: c_num_mm2s_channels is 17"),
        ("ten regions on an MCDMA", "c_group1_s2mm", "0000000000000111", "c_group1_s2mm has 3 channels"),
        ("ten regions on an MCDMA", "c_m_axis_mm2s_tdata_width", 64, "the stream has 64 bits, the way to memory 32"),
        ("video", "c_s_axis_s2mm_tdata_width", 24, "BD 41-737: dma_screen: c_s_axis_s2mm_tdata_width is read-only"),
        ("video", "c_s2mm_fsync", 1, "PG020: dma_screen has no parameter c_s2mm_fsync"),
        ("video", "c_m_axis_mm2s_tdata_width", 28, "PG020: dma_screen: c_m_axis_mm2s_tdata_width is 28"),
        ("video", "c_num_fstores", 33, "PG020: dma_screen: c_num_fstores is 33"),
    ],
)
def test_an_engine_with_a_mistake_is_refused(name: str, setting: str, value: object, said: str, tmp_path: Path) -> None:
    system = built(tmp_path, name)[0].system
    found = context(system)
    assert list(check_block_design(system, found)) == []
    cell = found["dmas"][-1]
    kept = tuple(entry for entry in cell.settings if entry[0] != setting)
    found["dmas"][-1] = replace(cell, settings=(*kept, (setting, value)))
    assert any(said in f"{one.rule}: {one.message}" for one in check_block_design(system, found))


@needs("tclsh")
def test_the_replay_refuses_a_width_that_a_vdma_takes_from_its_port(tmp_path: Path) -> None:
    _, out = built(tmp_path / "p", "video")
    script = out / "tcl/block_design.tcl"
    line = "set dma [cm_ip axi_vdma dma_screen]\n"
    more = "set_property CONFIG.c_s_axis_s2mm_tdata_width {24} $dma\n"
    script.write_text(script.read_text().replace(line, line + more))
    status, said, _ = replay(out, scripts(out)[0], tmp_path)
    assert status == 1
    assert "BD 41-737" in said
