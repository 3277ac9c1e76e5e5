# SPDX-License-Identifier: Apache-2.0
"""DMA engines and interrupts of a foreign design, in its overlay and its runtime schema; damaged archives."""

from __future__ import annotations

import struct
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from build_support import needs
from import_support import bitstream, described, hwh, memory, memory_range, module, port, ports, register

from cm.design.collect.collection import collect
from cm.design.collect.foreign_dma import engines, interrupts
from cm.design.collect.handoff import streams
from cm.design.collect.xsa import MAX_ARCHIVE, MAX_MEMBER
from cm.design.errors import BuildError
from cm.design.generate.interrupt_nodes import Line
from cm.design.partition.utilisation import part_of
from cm.design.parts import device_of
from cm.design.platforms import ZYNQ7000, ZYNQMP, platform_of
from cm.formats import fdt
from cm.formats import hwh as handoff
from cm.formats.hwh import HwhError
from cm.schema.model import Direction

LITE = port("s_axi_lite_aclk", "I", ("ps", "FCLK_CLK1"), kind="clk")
PLL = port("m_axi_s2mm_aclk", "I", ("mmcm", "clk_out1"), kind="clk").replace(
    "<PORT ", '<PORT CLKFREQUENCY="142857132" '
)


def design(*lines: tuple[str, str], processor: str = "processing_system7", pins: str | None = None) -> bytes:
    """An AXI DMA with both channels and a VDMA with one; `lines` go to the processor in that order."""
    concat = ports(*(port(f"In{index}", "I", line) for index, line in enumerate(lines)))
    clocks = port("FCLK_CLK1", "O", ("axi_dma_0", "s_axi_lite_aclk"), kind="clk")
    interrupt = pins or port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=len(lines))
    windows = memory(("axi_dma_0", 0x40400000, 0x10000), ("axi_vdma_0", 0x43000000, 0x10000))
    return hwh(
        module("ps", processor, windows, ports(interrupt, clocks)),
        module("concat", "xlconcat", concat),
        module("mmcm", "clk_wiz", ports(port("clk_out1", "O", kind="clk"))),
        module(
            "axi_dma_0",
            "axi_dma",
            ports(LITE, PLL),
            parameters={
                "C_M_AXIS_MM2S_TDATA_WIDTH": "32",
                "C_S_AXIS_S2MM_TDATA_WIDTH": "64",
                "C_SG_LENGTH_WIDTH": "23",
                "C_INCLUDE_S2MM_DRE": "1",
            },
        ),
        module("axi_vdma_0", "axi_vdma", parameters={"C_INCLUDE_MM2S": "0", "C_NUM_FSTORES": "5"}),
        device="zu3eg" if processor == "zynq_ultra_ps_e" else "7z020",
    )


BOTH = (("axi_dma_0", "mm2s_introut"), ("axi_dma_0", "s2mm_introut"), ("axi_vdma_0", "s2mm_introut"))


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    (tmp_path / "top.hwh").write_bytes(design(*BOTH))
    (tmp_path / "top.bit").write_bytes(bitstream(None))
    return tmp_path


def test_engines_have_addresses_interrupts_widths_and_clocks() -> None:
    dma, vdma = engines(handoff.parse(design(*BOTH)), ZYNQ7000).found
    assert (dma.base, dma.length_bits, vdma.frames) == (0x40400000, 23, 5)
    assert [(c.stream, c.line, c.width, c.realigns) for c in dma.channels] == [
        ("axi_dma_0_mm2s", Line("intc", "0 29 4"), 32, False),
        ("axi_dma_0_s2mm", Line("intc", "0 30 4"), 64, True),
    ]
    assert [(c.stream, c.line.cells) for c in vdma.channels] == [("axi_vdma_0", "0 31 4")]
    assert [(c.pin, c.source, c.rate) for c in dma.clocks] == [
        ("s_axi_lite_aclk", "&clkc 16", 0),
        ("m_axi_s2mm_aclk", "&cm_clock_142857132", 142857132),
    ]


@pytest.mark.parametrize(("built", "flushes"), [("1", True), ("0", False)])
def test_a_vdma_that_flushes_at_frames_of_another_size_is_stated_in_the_overlay(built: str, *, flushes: bool) -> None:
    text = design(*BOTH).decode("utf-8-sig")
    stores = '<PARAMETER NAME="C_NUM_FSTORES" VALUE="5"/>'
    assert stores in text
    text = text.replace(stores, f'{stores}<PARAMETER NAME="C_FLUSH_ON_FSYNC" VALUE="{built}"/>')
    assert engines(handoff.parse(text.encode()), ZYNQ7000).found[1].flushes is flushes


def test_the_second_interrupt_pin_of_zynqmp_counts_from_its_own_number() -> None:
    pins = port("pl_ps_irq0", "I", BOTH[0], kind="INTERRUPT") + port("pl_ps_irq1", "I", BOTH[1], kind="INTERRUPT")
    found = engines(handoff.parse(design(*BOTH, processor="zynq_ultra_ps_e", pins=pins)), ZYNQMP)
    assert [c.line for c in found.found[0].channels] == [Line("gic", "0 89 4"), Line("gic", "0 104 4")]
    assert [c.line for c in found.found[1].channels] == [Line("cm_polled", "0")]


def test_a_private_interrupt_is_not_one_that_a_device_tree_can_state() -> None:
    pins = port("Core0_nFIQ", "I", BOTH[0], kind="INTERRUPT")
    found = engines(handoff.parse(design(*BOTH, pins=pins)), ZYNQ7000)
    assert [c.stream for c in found.found[0].channels] == ["axi_dma_0_s2mm"]  # which is connected to nothing
    assert any("goes to Core0_nFIQ" in note for note in found.notes)


def test_interrupts_that_are_connected_to_nothing_are_lines_of_a_controller_that_polls() -> None:
    found = engines(handoff.parse(design(BOTH[1])), ZYNQ7000)
    dma, vdma = found.found
    assert [c.line for c in dma.channels] == [Line("cm_polled", "0"), Line("intc", "0 29 4")]
    assert [c.line for c in vdma.channels] == [Line("cm_polled", "1")]
    assert found.polled.words == (0x40400004, 0x43000034)  # DMASR of MM2S and of S2MM
    assert engines(handoff.parse(design(*BOTH)), ZYNQ7000).polled.words == ()


def behind_a_controller(*lines: tuple[str, str], kind: str = "0xFFFFFFF2", window: bool = True) -> handoff.Hwh:
    """The design with `lines` at an axi_intc, whose output is the processor's first interrupt."""
    text = design(("axi_intc_0", "irq")).decode("utf-8-sig")
    inputs = module("more", "xlconcat", ports(*(port(f"In{n}", "I", line) for n, line in enumerate(lines))))
    intc = module(
        "axi_intc_0",
        "axi_intc",
        ports(port("intr", "I", ("more", "dout"), bits=len(lines)), port("irq", "O")),
        parameters={"C_NUM_INTR_INPUTS": str(len(lines)), "C_KIND_OF_INTR": kind},
    )
    if window:
        text = text.replace("</MEMORYMAP>", memory_range("axi_intc_0", 0x41800000, 0x10000) + "</MEMORYMAP>", 1)
    return handoff.parse(text.replace("</MODULES>", f"{inputs}{intc}</MODULES>").encode())


def test_interrupts_behind_a_controller_are_lines_of_it() -> None:
    found = behind_a_controller(*BOTH)
    dma, vdma = engines(found, ZYNQ7000).found
    lines = [channel.line for channel in (*dma.channels, *vdma.channels)]
    assert lines == [Line("axi_intc_0", "0 4"), Line("axi_intc_0", "1 1"), Line("axi_intc_0", "2 4")]
    (intc,) = interrupts(found, ZYNQ7000).controllers.values()
    assert (intc.base, intc.inputs, intc.edges, intc.line) == (0x41800000, 3, 0b010, Line("intc", "0 29 4"))


def test_interrupts_behind_a_controller_that_the_processor_does_not_reach_are_left_out() -> None:
    found = engines(behind_a_controller(*BOTH, window=False), ZYNQ7000)
    assert found.found == []
    assert "axi_dma_0_mm2s: the interrupt of axi_dma_0 goes to axi_intc_0" in found.notes[0]


@needs("dtc")
@needs("fdtget")
def test_streams_of_the_schema_are_channels_of_the_overlay(theirs: Path, tmp_path: Path) -> None:
    found = collect([theirs])
    directions = {name: stream.direction for name, stream in found.config.streams.items()}
    assert directions == {
        "axi_dma_0_mm2s": Direction.MM2S,
        "axi_dma_0_s2mm": Direction.S2MM,
        "axi_vdma_0": Direction.S2MM,
    }
    assert "64 bits a beat" in found.config.streams["axi_dma_0_s2mm"].doc
    path = tmp_path / "static.dtbo"
    path.write_bytes(found.files["top_static.dtbo"])

    def get(node: str, key: str, kind: str = "i") -> str:
        command = ["fdtget", "-t", kind, str(path), f"/fragment@0/__overlay__/{node}", key]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    assert get("cm-streams", "dma-names", "s").split() == [s.channel for s in found.config.streams.values()]
    assert get("cm-streams", "fpga-cm,directions") == "1 2 2"
    assert get("cm-streams", "fpga-cm,types") == "1 1 2"
    channel = "dma-controller@40400000/dma-channel@40400030"
    assert get(channel, "interrupts") == "0 30 4"
    assert get(channel, "xlnx,datawidth") == "64"
    assert get("dma-controller@43000000", "compatible", "s") == "xlnx,axi-vdma-1.00.a"
    assert get("cm-clock-142857132", "clock-frequency") == "142857132"


def test_two_engines_of_one_name_have_streams_of_their_own() -> None:
    text = design(*BOTH).decode("utf-8-sig")
    more = module("sub_axi_vdma_0", "axi_vdma", parameters={"C_INCLUDE_MM2S": "0"})
    more = more.replace('FULLNAME="/sub_axi_vdma_0"', 'FULLNAME="/sub/axi_vdma_0"')
    found = handoff.parse(text.replace("</MODULES>", f"{more}</MODULES>").encode())
    names = {channel.stream for engine in engines(found, ZYNQ7000).found for channel in engine.channels}
    assert names < set(streams(found))
    assert "sub_axi_vdma_0" in streams(found)


def test_addresses_of_an_engine_have_the_width_that_it_was_customised_with() -> None:
    """Vivado writes it in lower case only."""
    text = design(*BOTH).decode("utf-8-sig")
    wide = text.replace('NAME="C_INCLUDE_S2MM_DRE" VALUE="1"/>', 'NAME="c_addr_width" VALUE="40"/>')
    assert wide != text
    assert [engine.address_bits for engine in engines(handoff.parse(wide.encode()), ZYNQ7000).found] == [40, 32]


def test_an_engine_without_scatter_gather_says_what_it_cannot_do(theirs: Path) -> None:
    text = (theirs / "top.hwh").read_text("utf-8-sig")
    simple = text.replace('NAME="C_SG_LENGTH_WIDTH" VALUE="23"/>', 'NAME="c_include_sg" VALUE="0"/>')
    assert simple != text
    (theirs / "top.hwh").write_text(simple)
    found = collect([theirs])
    why = "has no scatter/gather (c_include_sg=0): one transfer of at most 16383 bytes at a time"
    for direction in ("mm2s", "s2mm"):
        assert any(note.startswith(f"stream axi_dma_0_{direction}: axi_dma_0 {why}") for note in found.notes)
    assert "no scatter/gather" in found.config.streams["axi_dma_0_s2mm"].doc
    assert "scatter/gather" not in found.config.streams["axi_vdma_0"].doc
    assert [stream.max_length for stream in found.config.streams.values()] == [16383, 16383, None]


MC_LINES = tuple(("mc", f"{way}_ch{n}_introut") for way, n in (("mm2s", 1), ("mm2s", 2), ("s2mm", 1), ("s2mm", 2)))


def multichannel(*lines: tuple[str, str]) -> bytes:
    """An AXI MCDMA of two channels each way."""
    concat = ports(*(port(f"In{index}", "I", line) for index, line in enumerate(lines)))
    clocks = port("FCLK_CLK0", "O", ("mc", "s_axi_aclk"), kind="clk")
    interrupt = port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=len(lines))
    pins = [port(pin, "I", ("ps", "FCLK_CLK0"), kind="clk") for pin in ("s_axi_lite_aclk", "s_axi_aclk")]
    counts = {"C_NUM_MM2S_CHANNELS": "2", "C_NUM_S2MM_CHANNELS": "2", "C_SG_LENGTH_WIDTH": "26"}
    return hwh(
        module("ps", "processing_system7", memory(("mc", 0x40400000, 0x10000)), ports(interrupt, clocks)),
        module("concat", "xlconcat", concat),
        module("mc", "axi_mcdma", ports(*pins), parameters=counts),
        device="7z020",
    )


def test_a_multichannel_engine_has_a_stream_for_every_channel() -> None:
    found = handoff.parse(multichannel(*MC_LINES))
    (engine,) = engines(found, ZYNQ7000).found
    assert [(c.stream, c.number, c.line.cells) for c in engine.channels] == [
        ("mc_mm2s_0", 0, "0 29 4"),
        ("mc_mm2s_1", 1, "0 30 4"),
        ("mc_s2mm_0", 16, "0 31 4"),
        ("mc_s2mm_1", 17, "0 32 4"),
    ]
    assert list(streams(found)) == [channel.stream for channel in engine.channels]
    names = ["s_axi_lite_aclk", "m_axi_sg_aclk", "m_axi_mm2s_aclk", "m_axi_s2mm_aclk"]
    assert [(clock.pin, clock.source) for clock in engine.clocks] == [(name, "&clkc 15") for name in names]


def test_a_direction_of_a_multichannel_engine_that_lacks_an_interrupt_is_left_out() -> None:
    found = engines(handoff.parse(multichannel(*MC_LINES[:3])), ZYNQ7000)
    assert [c.stream for c in found.found[0].channels] == ["mc_mm2s_0", "mc_mm2s_1"]
    assert any("stream mc_s2mm_1: the interrupt of mc goes nowhere" in note for note in found.notes)
    assert any("mc_s2mm_0 is left out too" in note for note in found.notes)


@needs("dtc")
@needs("fdtget")
def test_the_node_of_a_multichannel_engine_is_as_the_kernels_binding_has_it(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in/top.hwh").write_bytes(multichannel(*MC_LINES))
    (tmp_path / "in/top.bit").write_bytes(bitstream(None))
    found = collect([tmp_path / "in"])
    path = tmp_path / "static.dtbo"
    path.write_bytes(found.files["top_static.dtbo"])

    def get(node: str, key: str, kind: str = "i") -> str:
        command = ["fdtget", "-t", kind, str(path), f"/fragment@0/__overlay__/{node}", key]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    engine = "dma-controller@40400000"
    assert get(engine, "compatible", "s") == "xlnx,axi-mcdma-1.00.a"
    assert get(f"{engine}/dma-channel@40400500", "compatible", "s") == "xlnx,axi-dma-s2mm-channel"
    assert get(f"{engine}/dma-channel@40400500", "dma-channels") == "2"
    assert get(f"{engine}/dma-channel@40400500", "interrupts") == "0 31 4 0 32 4"
    assert get("cm-streams", "dmas").split()[1::2] == ["0", "1", "16", "17"]
    assert get("cm-streams", "fpga-cm,directions") == "1 1 2 2"
    assert get("cm-streams", "dma-names", "s").split() == [stream.channel for stream in found.config.streams.values()]


# interrupts --------------------------------------------------------------------------------------

IRQ = port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=4)
FIQ = port("Core0_nFIQ", "I", ("cam", "fiq"), kind="INTERRUPT")


def interrupting(*lines: tuple[str, str], pins: str = IRQ, more: tuple[str, ...] = ()) -> bytes:
    """Two instances with windows and a DMA engine; `lines` go to the processor's interrupts in that order."""
    windows = memory(("cam", 0x43C00000, 0x10000), ("tx", 0x43C10000, 0x10000), ("dma", 0x40400000, 0x10000))
    return hwh(
        module("ps", "processing_system7", windows, ports(pins)),
        module("concat", "xlconcat", ports(*(port(f"In{index}", "I", line) for index, line in enumerate(lines)))),
        module("cam", "cam", described(register("CTRL", 0))),
        module("tx", "tx"),
        module("dma", "axi_dma", described(register("MM2S_DMACR", 0))),
        *more,
    )


def test_of_several_lines_of_an_instance_the_first_is_reported_and_the_others_are_noted() -> None:
    lines = (("tx", "irq0"), ("tx", "irq1"), ("cam", "done"), ("dma", "mm2s_introut"))
    found = interrupts(handoff.parse(interrupting(*lines)), ZYNQ7000)
    assert {name: line.base_address for name, line in found.lines.items()} == {
        "tx_irq0": 0x43C10000,
        "cam_done": 0x43C00000,
    }
    assert {name: line.cells for name, line in found.nodes.items()} == {"tx": "0 29 4", "cam": "0 31 4"}
    (note,) = found.notes
    assert note.startswith("interrupt irq1 of tx is not its first")


def test_a_line_that_no_overlay_can_give_is_noted_and_the_next_one_taken() -> None:
    """A private interrupt of a core comes first in the processor's ports; the shared one is the UIO device's."""
    found = interrupts(handoff.parse(interrupting(("cam", "irq"), pins=FIQ + IRQ)), ZYNQ7000)
    assert (found.lines["cam_irq"].base_address, found.nodes) == (0x43C00000, {"cam": Line("intc", "0 29 4")})
    assert found.notes[0].startswith("interrupt fiq of cam goes to Core0_nFIQ")


def test_a_line_behind_an_interrupt_controller_without_a_window_is_noted() -> None:
    intc = module("intc", "axi_intc", ports(port("intr", "I", ("cam", "irq")), port("irq", "O")))
    found = interrupts(handoff.parse(interrupting(("intc", "irq"), more=(intc,))), ZYNQ7000)
    assert (found.lines, found.nodes) == ({}, {})
    assert found.notes[0].startswith("interrupt irq of cam goes to intc: no overlay can give that")


def cells(node: fdt.FdtNode, name: str) -> tuple[int, ...]:
    return tuple(cell for (cell,) in struct.iter_unpack(">I", node.properties[name]))


@needs("dtc")
def test_controllers_stand_in_the_overlay_before_those_who_use_them(tmp_path: Path) -> None:
    """Linked rightly only so, and an overlay is removed in reverse."""
    intc = module(
        "irqs",
        "axi_intc",
        ports(port("intr", "I", ("cam", "irq")), port("irq", "O")),
        parameters={"C_NUM_INTR_INPUTS": "1", "C_KIND_OF_INTR": "0xFFFFFFFF"},
    )
    text = interrupting(("irqs", "irq"), more=(intc,)).decode("utf-8-sig")
    text = text.replace("</MEMORYMAP>", memory_range("irqs", 0x41800000, 0x10000) + "</MEMORYMAP>", 1)
    (tmp_path / "top.hwh").write_text(text)
    (tmp_path / "top.bit").write_bytes(bitstream(None))
    found = collect([tmp_path])
    assert any("needs the module cm_intc" in note for note in found.notes)
    assert set(found.config.interrupts) == {"cam_irq"}
    root = fdt.unpack(found.files["top_static.dtbo"])
    nodes = {path.rpartition("/")[2]: node for path, node in root.walk() if "compatible" in node.properties}
    names = list(nodes)
    assert names.index("interrupt-controller@41800000") < names.index("cam@43c00000")
    assert names.index("interrupt-controller@40400004") < names.index("dma-controller@40400000")
    assert "irqs@41800000" not in names  # no window for user space
    controller, polled = nodes["interrupt-controller@41800000"], nodes["interrupt-controller@40400004"]
    assert cells(controller, "interrupts") == (0, 29, 4)
    assert (cells(controller, "xlnx,num-intr-inputs"), cells(controller, "xlnx,kind-of-intr")) == ((1,), (1,))
    assert cells(nodes["cam@43c00000"], "interrupts") == (0, 1)  # an edge, as the core was built
    assert cells(polled, "reg") == (0x40400004, 4, 0x40400034, 4)
    assert (cells(polled, "fpga-cm,pending"), cells(polled, "fpga-cm,idle")) == ((0x7000,), (3,))
    assert cells(nodes["dma-channel@40400030"], "interrupts") == (1,)


def test_collected_schema_and_overlay_agree_and_leave_engines_to_their_driver(tmp_path: Path) -> None:
    (tmp_path / "top.hwh").write_bytes(interrupting(("tx", "irq0"), ("tx", "irq1"), ("dma", "mm2s_introut")))
    (tmp_path / "top.bit").write_bytes(bitstream(None))
    found = collect([tmp_path])
    assert set(found.config.interrupts) == {"tx_irq0"}
    assert set(found.config.registers) == {"cam_ctrl"}
    assert any("irq1 of tx" in note for note in found.notes)


def test_a_description_in_an_archive_is_called_by_the_archive(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "system.xsa", "w") as archive:
        archive.writestr("top.hwh", b"<html/>")
    with pytest.raises(HwhError, match=f"^{tmp_path}/system.xsa: top.hwh: no hardware handoff"):
        collect([tmp_path / "system.xsa"])


# parts of boards, as their board files in Xilinx/XilinxBoardStore 20bbb12 have them
BOARDS = {
    "Ultra96 v2": ("xczu3eg-sbva484-1-i", "zynqmp"),
    "ZCU104": ("xczu7ev-ffvc1156-2-e", "zynqmp"),
    "ZCU102": ("xczu9eg-ffvb1156-2-e", "zynqmp"),
    "KV260, KR260, K26": ("xck26-sfvc784-2LV-c", "zynqmp"),
    "PYNQ-ZU": ("xczu5eg-sfvc784-1-e", "zynqmp"),
    "PYNQ-Z2": ("xc7z020clg400-1", "zynq7000"),
    "ZedBoard": ("xc7z020clg484-1", "zynq7000"),
}


@pytest.mark.parametrize("board", BOARDS)
def test_the_parts_of_known_boards_have_a_platform(board: str) -> None:
    part, platform = BOARDS[board]
    assert platform_of(part).name == platform
    assert part_of(device_of(part)).bytes > 0


# archives ----------------------------------------------------------------------------------------


def packed(path: Path, *members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return path


def damaged(path: Path, change: Callable[[bytes], bytes]) -> Path:
    path.write_bytes(change(packed(path, ("top.bit", bytes(100_000)), method=zipfile.ZIP_STORED).read_bytes()))
    return path


def at_central(offset: int, value: int) -> Callable[[bytes], bytes]:
    """Change a byte of the first entry of an archive's directory."""

    def change(data: bytes) -> bytes:
        at = data.index(b"PK\x01\x02") + offset
        return data[:at] + bytes([value]) + data[at + 1 :]

    return change


def lying(data: bytes) -> bytes:
    return data.replace((100_000).to_bytes(4, "little"), (10).to_bytes(4, "little"))


BAD = {
    "a member that unpacks to too much": (
        lambda path: packed(path, ("top.bit", bytes(MAX_MEMBER + 1))),
        r"top\.bit has 67108865 bytes: more than an XSA holds",
    ),
    "a directory that lies about a length": (lambda path: damaged(path, lying), r"a\.xsa: not an XSA or HDF"),
    # zipfile ends a name at a NUL, and refuses it till 3.12
    "a member without a name": (
        lambda path: damaged(path, lambda data: data.replace(b"top.bit", b"\0op.bit")),
        r"a\.xsa: not an XSA or HDF|neither a \.hwh",
    ),
    "two members of one name": (
        lambda path: packed(path, ("a/top.bit", b"1"), ("b/top.bit", b"2")),
        "a/top.bit and b/top.bit have one name",
    ),
    "a password": (lambda path: damaged(path, at_central(8, 1)), r"a\.xsa: not an XSA or HDF"),
    "an unknown method": (lambda path: damaged(path, at_central(10, 99)), r"a\.xsa: not an XSA or HDF"),
    "no archive": (lambda path: damaged(path, lambda _: b"PK nonsense"), r"a\.xsa: not an XSA or HDF"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_archive_is_reported(name: str, tmp_path: Path) -> None:
    make, said = BAD[name]
    with pytest.raises(BuildError, match=said):
        collect([make(tmp_path / "a.xsa")])


def test_members_that_are_too_much_together_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_ARCHIVE > MAX_MEMBER
    monkeypatch.setattr("cm.design.collect.xsa.MAX_ARCHIVE", 3000)
    path = packed(tmp_path / "many.xsa", *((f"{index}.bit", bytes(1000)) for index in range(4)))
    with pytest.raises(BuildError, match=r"3\.bit has 1000 bytes"):
        collect([path])
