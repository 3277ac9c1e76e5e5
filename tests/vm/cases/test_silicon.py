# SPDX-License-Identifier: Apache-2.0
"""cm_dma and cm_icap on the kernel's own xilinx_dma, unmodified, over models of PG021 and PG020.

Each test says what the product guide, the binding or our uapi demands.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import plsim
import pytest
from axi import DMASR, HALTED, S2MM, SLAVE_ERROR, Engine
from boardfile import FIRMWARE, write_bitstreams
from served import PATIENCE, driver, until

from cm import device
from cm.formats import fdt
from cm.formats.bitstream import to_dma_words

pytestmark = pytest.mark.needs("xilinx_dma")
SG, SIMPLE, VDMA, MC = Engine("sg"), Engine("simple"), Engine("vdma"), Engine("mc")
FRAME = 4096


def words(first: int, length: int = FRAME) -> bytes:
    return (np.arange(length // 4, dtype="<u4") + first).tobytes()


@pytest.fixture(scope="module", autouse=True)
def bench() -> Iterator[None]:
    """The engines of silicon-bench.dtso."""
    overlays = device.Overlays("/")
    overlays.apply("bench", plsim.overlay("silicon-bench"))
    until(lambda: {"sg_in", "simple_in", "vdma_in", "mc_in1"} <= set(device.list_dma()))
    yield
    overlays.remove("bench")
    assert not list(Path("/sys/bus/platform/drivers/xilinx-vdma").glob("58033000.*"))


@pytest.fixture
def sg_in() -> Iterator[device.AxiDma]:
    with device.AxiDma.open("sg_in") as channel:
        yield channel


@pytest.fixture
def sg_out() -> Iterator[device.AxiDma]:
    with device.AxiDma.open("sg_out") as channel:
        yield channel


@pytest.fixture
def simple_in() -> Iterator[device.AxiDma]:
    with device.AxiDma.open("simple_in") as channel:
        yield channel


@pytest.fixture
def simple_out() -> Iterator[device.AxiDma]:
    with device.AxiDma.open("simple_out") as channel:
        yield channel


# what the tree describes


@pytest.mark.parametrize("node", [f"5803{n}000.dma-controller" for n in range(9)])
def test_each_engine_has_the_kernels_own_driver(node: str) -> None:
    assert driver(node) == "xilinx-vdma"


@pytest.mark.parametrize("node", ["58010000.fpga-bridge", "58011000.fpga-bridge"])
def test_a_decoupler_of_xilinx_has_the_kernels_own_driver(node: str) -> None:
    assert driver(node) == "xlnx_pr_decoupler"


# T0: scatter/gather, PG021 chapter 3, "Scatter/Gather Mode"


def test_a_packet_is_received_with_its_length(sg_in: device.AxiDma) -> None:
    assert device.DmaCaps.RESIDUE in sg_in.info.caps
    with sg_in.allocate(FRAME) as buffer:
        sg_in.submit(buffer, length=FRAME)
        SG.give(words(3, 100))
        done = sg_in.wait(PATIENCE)
        assert (done.status, done.length) == (0, 100)
        assert buffer.array(0, 100).tobytes() == words(3, 100)


def test_a_packet_is_sent_whole_and_with_its_end(sg_out: device.AxiDma) -> None:
    with sg_out.allocate(FRAME) as buffer:
        buffer.array()[:] = np.frombuffer(words(5), np.uint8)
        sg_out.submit(buffer, length=FRAME)
        assert (sg_out.wait(PATIENCE).status, SG.sent()) == (0, words(5))


# T1: PG021 table 2-6, IRQThreshold


def test_each_of_eight_queued_frames_is_reported_before_the_next_begins(sg_in: device.AxiDma) -> None:
    before = SG.state("s2mm_interrupts")
    with sg_in.allocate(8 * FRAME) as buffer:
        for index in range(8):
            sg_in.submit(buffer, index * FRAME, FRAME, cookie=index)
        for index in range(8):
            assert sg_in.completions() == []
            SG.give(words(index))
            done = sg_in.wait(PATIENCE)
            assert (done.cookie, done.status, done.length) == (index, 0, FRAME)
    assert SG.state("s2mm_interrupts") == before + 8


def test_frames_that_come_at_once_are_all_reported_in_order_with_an_interrupt_each(sg_in: device.AxiDma) -> None:
    before = SG.state("s2mm_interrupts")
    with sg_in.allocate(8 * FRAME) as buffer:
        with SG.held("s2mm"):
            for index in range(8):
                sg_in.submit(buffer, index * FRAME, FRAME, cookie=index)
                SG.give(words(100 * index))
        done = [sg_in.wait(PATIENCE) for _ in range(8)]
        assert [one.cookie for one in done] == list(range(8))
        assert buffer.array().tobytes() == b"".join(words(100 * index) for index in range(8))
    assert SG.state("s2mm_interrupts") == before + 8


# T2: PG021 table 2-6, Reset: both channels


def test_closing_one_channel_leaves_what_the_other_waits_for(sg_in: device.AxiDma) -> None:
    with sg_in.allocate(2 * FRAME) as buffer:
        sg_in.submit(buffer, 0, FRAME, cookie=77)
        sg_in.submit(buffer, FRAME, FRAME, cookie=78)
        with SG.held("mm2s"), device.AxiDma.open("sg_out") as out, out.allocate(FRAME) as source:
            out.submit(source, length=FRAME)
            out.cancel()
            assert out.wait(PATIENCE).status == -errno.ECANCELED
        for cookie in (77, 78):
            SG.give(words(cookie))
            done = sg_in.wait(PATIENCE)
            assert (done.cookie, done.status, done.length) == (cookie, 0, FRAME)
        assert buffer.array().tobytes() == words(77) + words(78)


def test_closing_an_idle_channel_resets_nothing(sg_in: device.AxiDma) -> None:
    with sg_in.allocate(FRAME) as buffer:
        sg_in.submit(buffer, length=FRAME)
        before = SG.state("s2mm_resets")
        device.AxiDma.open("sg_out").close()
        assert SG.state("s2mm_resets") == before
        sg_in.cancel()


def test_a_cancel_of_a_channel_that_does_not_halt_ends_and_the_channel_works_again(sg_in: device.AxiDma) -> None:
    with sg_in.allocate(FRAME) as buffer:
        sg_in.submit(buffer, length=FRAME)
        with SG.stuck("s2mm"):
            sg_in.cancel()
        assert sg_in.wait(PATIENCE).status == -errno.ECANCELED
        sg_in.submit(buffer, length=FRAME)
        SG.give(words(1))
        assert sg_in.wait(PATIENCE).length == FRAME


# T3, T4: PG021 chapter 3, "Direct Register Mode (Simple DMA)"; table 2-23, S2MM_LENGTH


def test_simple_mode_tells_the_length_that_its_register_has(simple_in: device.AxiDma) -> None:
    assert device.DmaCaps.RESIDUE | device.DmaCaps.SIMPLE in simple_in.info.caps
    with simple_in.allocate(FRAME) as buffer:
        for index, length in enumerate((100, FRAME, 8)):
            simple_in.submit(buffer, length=FRAME)
            SIMPLE.give(words(index, length))
            done = simple_in.wait(PATIENCE)
            assert (done.status, done.length) == (0, length)


def test_simple_mode_moves_each_of_six_queued_transfers(simple_out: device.AxiDma) -> None:
    before = SIMPLE.state("mm2s_transfers")
    with simple_out.allocate(6 * FRAME) as buffer:
        buffer.array()[:] = np.frombuffer(b"".join(words(7 * index) for index in range(6)), np.uint8)
        with SIMPLE.held("mm2s"):
            for index in range(6):
                simple_out.submit(buffer, index * FRAME, FRAME, cookie=index)
        done = [simple_out.wait(PATIENCE) for _ in range(6)]
    assert [(one.cookie, one.status) for one in done] == [(index, 0) for index in range(6)]
    assert SIMPLE.state("mm2s_transfers") == before + 6
    assert [SIMPLE.sent() for _ in range(6)] == [words(7 * index) for index in range(6)]
    assert SIMPLE.state("mm2s_misuse") == 0  # no LENGTH was written while one was under way


def test_what_the_length_register_does_not_hold_is_refused(simple_out: device.AxiDma) -> None:
    assert simple_out.info.max_length == (1 << 14) - 4
    with simple_out.allocate(1 << 15) as buffer:
        simple_out.submit(buffer, length=simple_out.info.max_length)
        assert simple_out.wait(PATIENCE).status == 0
        assert SIMPLE.sent(1 << 20) == bytes((1 << 14) - 4)
        with pytest.raises(device.DeviceError) as refused:
            simple_out.submit(buffer, length=1 << 14)
        assert refused.value.errno == errno.EMSGSIZE


# T5: PG020 chapter 2, table 2-10 (Circular_Park), chapter 3


def test_a_video_frame_is_received_and_nothing_is_written_after_its_end() -> None:
    lines, line, stride = 48, 64, 128
    with device.AxiDma.open("vdma_in") as channel, channel.allocate(lines * stride) as buffer:
        assert device.DmaCaps.VIDEO in channel.info.caps
        channel.submit_video(buffer, lines, line, stride, cookie=4)
        VDMA.give(words(1, lines * line))
        done = channel.wait(PATIENCE)
        assert (done.cookie, done.status, done.length) == (4, 0, lines * line)
        after = VDMA.state("s2mm_transfers")
        VDMA.give(words(9999, lines * line))
        VDMA.until("s2mm_waiting", 1)
        assert VDMA.state("s2mm_sr") & HALTED
        assert VDMA.state("s2mm_transfers") == after
        got = buffer.array(0, lines * stride).reshape(lines, stride)
        assert got[:, :line].tobytes() == words(1, lines * line)
        assert not got[:, line:].any()
        channel.submit_video(buffer, lines, line, stride, cookie=5)
        assert channel.wait(PATIENCE).cookie == 5
        assert buffer.array(0, lines * stride).reshape(lines, stride)[:, :line].tobytes() == words(9999, lines * line)


# PG020, S2MM_VDMASR: SOFEarlyErr, SOFLateErr; the channel goes on


@pytest.mark.parametrize("size", [FRAME - 4, FRAME + 4])
def test_a_frame_of_another_size_is_dropped_and_the_next_one_is_reported(size: int) -> None:
    lines, line = 32, FRAME // 32
    with device.AxiDma.open("vdma_in") as channel, channel.allocate(FRAME) as buffer:
        channel.submit_video(buffer, lines, line, line, cookie=1)
        VDMA.give(words(5, size))
        VDMA.give(words(9, FRAME))
        done = channel.wait(PATIENCE)
        assert (done.cookie, done.status, done.length) == (1, 0, FRAME)
        assert buffer.array(0, FRAME).tobytes() == words(9, FRAME)


def test_a_vdma_refuses_a_transfer_without_lines() -> None:
    opened = device.AxiDma.open("vdma_in")
    with opened as channel, channel.allocate(FRAME) as buffer, pytest.raises(device.DeviceError):
        channel.submit(buffer, length=FRAME)


# AXI MCDMA, PG288: channels behind one port, a reset for all of them


def give_to(channel: int, data: bytes) -> None:
    """A packet with a TDEST."""
    MC.set("tdest", channel)
    MC.give(data)


def test_channels_of_a_multichannel_engine_get_what_is_for_them() -> None:
    first, second = device.AxiDma.open("mc_in0"), device.AxiDma.open("mc_in1")
    with first, second, first.allocate(2 * FRAME) as one, second.allocate(2 * FRAME) as two:
        for channel, buffer in ((first, one), (second, two)):
            for index in range(2):
                channel.submit(buffer, index * FRAME, FRAME, cookie=index)
        for number, length in ((1, 100), (0, FRAME), (1, 8), (0, 12)):
            give_to(number, words(1000 * number + length, length))
        got = [
            [(done.cookie, done.status, done.length) for done in (c.wait(PATIENCE), c.wait(PATIENCE))]
            for c in (first, second)
        ]
        assert got == [[(0, 0, FRAME), (1, 0, 12)], [(0, 0, 100), (1, 0, 8)]]
        assert one.array(0, FRAME).tobytes() == words(FRAME, FRAME)
        assert two.array(FRAME, 8).tobytes() == words(1008, 8)


def test_a_multichannel_engine_sends_whole_packets_of_each_channel() -> None:
    first, second = device.AxiDma.open("mc_out0"), device.AxiDma.open("mc_out1")
    with first, second, first.allocate(FRAME) as one, second.allocate(FRAME) as two:
        for channel, buffer, value in ((first, one, 5), (second, two, 6)):
            buffer.array()[:] = np.frombuffer(words(value), np.uint8)
            channel.submit(buffer, length=FRAME)
            assert channel.wait(PATIENCE).status == 0
            assert MC.sent() == words(value)


def test_closing_a_channel_of_a_multichannel_engine_leaves_the_others_what_they_wait_for() -> None:
    with device.AxiDma.open("mc_in0") as stays, stays.allocate(2 * FRAME) as buffer:
        for index in range(2):
            stays.submit(buffer, index * FRAME, FRAME, cookie=index)
        with device.AxiDma.open("mc_in1") as goes, goes.allocate(FRAME) as other:
            goes.submit(other, length=FRAME)
            goes.cancel()
            assert goes.wait(PATIENCE).status == -errno.ECANCELED
        for index in range(2):
            give_to(0, words(index))
            done = stays.wait(PATIENCE)
            assert (done.cookie, done.status, done.length) == (index, 0, FRAME)
        assert buffer.array().tobytes() == words(0) + words(1)


# T6: cyclic transfers


@pytest.mark.parametrize(("name", "engine"), [("sg_in", SG), ("mc_in0", MC)])
def test_each_period_of_a_cyclic_transfer_is_reported(name: str, engine: Engine) -> None:
    engine.set("tdest", 0)
    with device.AxiDma.open(name) as channel, channel.allocate(4 * FRAME) as buffer:
        assert device.DmaCaps.CYCLIC in channel.info.caps
        channel.submit(buffer, length=4 * FRAME, cyclic=True, period=FRAME, cookie=9)
        for index in range(10):
            engine.give(words(index))
            done = channel.wait(PATIENCE)
            assert (done.cookie, done.status, done.length, done.sequence) == (9, 0, FRAME, index)
            place = index % 4
            assert buffer.array(place * FRAME, FRAME).tobytes() == words(index)
        channel.cancel()
        assert channel.wait(PATIENCE).status == -errno.ECANCELED


# errors: PG021 table 2-7, DMASlvErr; the driver tells none of them


@pytest.mark.parametrize("error", [0x10, 0x20, 0x40])
def test_an_error_of_the_engine_ends_the_transfer_that_it_hit(sg_in: device.AxiDma, error: int) -> None:
    with sg_in.allocate(2 * FRAME) as buffer:
        sg_in.submit(buffer, 0, FRAME, cookie=1)
        sg_in.submit(buffer, FRAME, FRAME, cookie=2)
        SG.inject("s2mm", error)
        SG.give(words(0))
        done = sg_in.wait(PATIENCE)
        assert (done.cookie, done.status) == (1, -errno.EIO)
        again = sg_in.wait(PATIENCE)  # the packet was not taken
        assert (again.cookie, again.status, again.length) == (2, 0, FRAME)


def test_an_error_in_simple_mode_is_no_success(simple_out: device.AxiDma) -> None:
    with simple_out.allocate(2 * FRAME) as buffer:
        SIMPLE.inject("mm2s", SLAVE_ERROR)
        simple_out.submit(buffer, 0, FRAME, cookie=1)
        simple_out.submit(buffer, FRAME, FRAME, cookie=2)
        done = [simple_out.wait(PATIENCE) for _ in range(2)]
        assert [(one.cookie, one.status) for one in done] == [(1, -errno.EIO), (2, 0)]
        SIMPLE.sent()


def test_interrupts_are_acknowledged_by_writing_their_bits_and_no_error_bit(sg_in: device.AxiDma) -> None:
    SG.clear()
    with sg_in.allocate(FRAME) as buffer:
        sg_in.submit(buffer, length=FRAME)
        SG.give(words(0))
        sg_in.wait(PATIENCE)
    acknowledged = [access.value for access in SG.trace() if access.what == "w" and access.offset == S2MM + DMASR]
    assert acknowledged
    assert not any(value & 0x770 for value in acknowledged)


# T8, T9, T11: configuration ports


def port_behind(dma: str) -> str:
    """The port whose device tree node names an engine."""
    for name in device.list_icap():
        node = Path("/sys/class/misc", name, "device/of_node")
        if dma in node.resolve().name:
            return name
    raise AssertionError(f"no port like {dma}")


def bitstream() -> bytes:
    write_bitstreams()
    return to_dma_words((FIRMWARE / "edge.bit").read_bytes())


@contextlib.contextmanager
def opened(name: str) -> Iterator[tuple[device.Icap, Callable[[], None]]]:
    """A port, and what starts a load through it."""
    data = bitstream()
    with device.Icap.open(name) as port, port.allocate(len(data)) as buffer:
        buffer.array(0, len(data))[:] = bytearray(data)
        yield port, lambda: port.load(buffer, len(data))


def load(name: str) -> device.IcapCompletion:
    with opened(name) as (port, start):
        start()
        return port.wait(PATIENCE)


def test_a_load_longer_than_the_length_register_is_cut_into_transfers() -> None:
    engine = Engine("icap14")
    before, loads = engine.state("mm2s_transfers"), engine.number("loads")
    done = load(port_behind("icap-of-a-simple-dma"))
    length = len(bitstream())
    assert (done.status, done.length) == (0, length)
    assert engine.state("mm2s_transfers") - before == -(-length // ((1 << 14) - 4))
    assert (engine.number("loads"), engine.number("words")) == (loads + 1, length // 4)


# the bits of kmod/include/cm_icap_port.h, as cm build's own RTL and a wrapper that knows the cause set them
@pytest.mark.parametrize(
    ("status", "result"),
    [
        (0b101, 0),
        (0b111, -errno.EIO),  # FAILED, as cm_control.v has it
        (0b101 | 1 << 8, -errno.EILSEQ),
        (0b101 | 1 << 9, -errno.ENODEV),
        (0b101 | 1 << 10, -errno.EIO),
        (0b101 | 1 << 11, -errno.ETIMEDOUT),
        (0b101 | 1 << 12, -errno.EIO),
        (0b100, -errno.ETIMEDOUT),  # never DONE
    ],
)
def test_each_bit_of_the_ports_status_register_is_understood(status: int, result: int) -> None:
    Engine("icap").set("force_status", status)
    assert load(port_behind("icap@58020000")).status == result
    assert load(port_behind("icap@58020000")).status == 0


def bridge(name: str) -> str:
    return next(Path("/sys/bus/platform/devices", name, "fpga_bridge").glob("*/state")).read_text().strip()


def test_a_port_that_the_platform_refuses_leaves_bridge_and_engine_as_they_were() -> None:
    name, engine = port_behind("icap-that-is-refused"), Engine("refused")
    engine.clear()
    assert bridge("58013000.fpga-bridge") == "enabled"
    with pytest.raises(device.DeviceError):
        load(name)
    assert bridge("58013000.fpga-bridge") == "enabled"
    assert engine.trace() == []
    with device.Icap.open(name) as port:
        assert port.info.denied  # it was asked for when the driver started
        assert port.status().state is device.IcapState.IDLE


def firmware(name: str) -> Path:
    """The model of the ZynqMP's platform firmware, which sees cm_icap's own calls."""
    return Path("/sys/kernel/debug/cm_axi/firmware", name)


@pytest.fixture
def given() -> Iterator[str]:
    """A port that the platform gives."""
    firmware("secure_access").write_text("1")
    yield port_behind("icap-that-is-refused")
    firmware("secure_access").write_text("0")


def test_a_port_that_the_platform_gives_is_selected_for_the_load_alone(given: str) -> None:
    engine = Engine("refused")
    writes, loads = int(firmware("writes").read_text()), engine.number("loads")
    assert load(given).status == 0
    assert engine.number("loads") == loads + 1
    assert int(firmware("writes").read_text()) == writes + 2  # ICAP, and PCAP again
    assert firmware("pcap_ctrl").read_text() == "0x00000001\n"


# one of ICAP and PCAP at a time: the platform's own FPGA manager is held for the length of a load


PCAP = Path("/sys/kernel/debug/cm_pcap")


@contextlib.contextmanager
def through_platform() -> Iterator[None]:
    """An overlay that the platform's own manager loads an image for; taken away again by the thread that applied it."""
    write_bitstreams()
    image = FIRMWARE / "edge.bit"
    content = {"firmware-name": f"{image.relative_to('/lib/firmware')}\0".encode(), "partial-fpga-config": b""}
    overlays = device.Overlays("/")
    overlays.apply("platform", fdt.pack(fdt.overlay("/fpga-full", fdt.FdtNode("", content))))
    yield
    overlays.remove("platform")


def test_the_platforms_manager_is_busy_while_the_port_loads(given: str) -> None:
    loads = int((PCAP / "loads").read_text())
    with opened(given) as (port, start):
        with Engine("refused").held("mm2s"):
            start()
            with pytest.raises(device.DeviceError), through_platform():
                pass
            assert int((PCAP / "loads").read_text()) == loads
            assert port.status().loading
        assert port.wait(PATIENCE).ok
    with through_platform():
        assert int((PCAP / "loads").read_text()) == loads + 1


def test_the_port_is_busy_while_the_platforms_manager_loads(given: str) -> None:
    def apply() -> None:
        with through_platform():
            pass

    engine, hold = Engine("refused"), PCAP / "hold"
    loads, writes = engine.number("loads"), firmware("writes").read_text()
    managers = [device.FpgaManager(int(name.removeprefix("fpga")), "/") for name in device.list_fpga_managers("/")]
    hold.write_text("1")
    with ThreadPoolExecutor(1) as beside:
        other = beside.submit(apply)
        try:
            until(lambda: any(manager.state == "write" for manager in managers))
            with pytest.raises(device.DeviceBusy):
                load(given)
        finally:
            hold.write_text("0")
        other.result()
    assert (engine.number("loads"), firmware("writes").read_text()) == (loads, writes)
    assert bridge("58013000.fpga-bridge") == "enabled"
    assert load(given).status == 0


# clocks: UG585, FPGA0_CLK_CTRL: two divisors of 1 to 63, the nearest rate below


CLOCKS = Path("/sys/class/cm_clock")


def test_a_clocks_assigned_rate_is_in_force() -> None:
    assert (CLOCKS / "fclk1/rate").read_text() == "100000000\n"


def test_a_clock_is_rounded_down_and_says_so() -> None:
    rate, rounded = CLOCKS / "fclk0/rate", CLOCKS / "fclk0/round"
    rounded.write_text("142860000")
    assert (rate.read_text(), rounded.read_text()) == ("50000000\n", "142857142\n")
    rate.write_text("142860000")
    assert rate.read_text() == "142857142\n"
    rate.write_text("50000000")
    assert rate.read_text() == "50000000\n"


@pytest.mark.parametrize("text", ["", "0", "fast", "-1"])
def test_what_is_no_rate_is_refused(text: str) -> None:
    with pytest.raises(OSError, match="Invalid argument"), (CLOCKS / "fclk0/rate").open("w") as file:
        file.write(text or "\n")


def test_a_clock_runs_while_it_is_enabled_and_stops_with_its_node() -> None:
    def users() -> int:
        return int(Path("/sys/kernel/debug/clk/model_fclk0/clk_enable_count").read_text())

    for _ in range(2):
        (CLOCKS / "fclk0/enable").write_text("1")
        assert (users(), (CLOCKS / "fclk0/enable").read_text()) == (1, "1\n")
    bound = Path("/sys/bus/platform/drivers/cm_clock")
    name = next(link.name for link in bound.iterdir() if link.is_symlink() and link.name != "module")
    (bound / "unbind").write_text(name)
    assert (users(), (CLOCKS / "fclk0").exists()) == (0, False)
    (bound / "bind").write_text(name)
    assert (CLOCKS / "fclk0/enable").read_text() == "0\n"


# memory that is not coherent: DMA_BUF_IOCTL_SYNC


def test_a_frame_is_synchronised_once_over_its_length_for_all_its_readers(sg_in: device.AxiDma) -> None:
    synced = Path("/sys/kernel/debug/cm_dma/synced")

    def read_by_two(buffer: device.DmaBuffer) -> int:
        before = int(synced.read_text())
        for _ in range(2):
            buffer.sync_begin(write=False)
            buffer.sync_end(write=False)
        return int(synced.read_text()) - before

    with sg_in.allocate(1 << 20) as buffer:
        assert read_by_two(buffer) == 0  # nobody has written it
        sg_in.submit(buffer, FRAME, FRAME)
        SG.give(words(0, 1000))
        sg_in.wait(PATIENCE)
        assert read_by_two(buffer) == 1000
        sg_in.submit(buffer, 0, FRAME)
        sg_in.cancel()
        assert read_by_two(buffer) == FRAME  # how far it came nobody knows
        assert read_by_two(buffer) == 0


# what a channel is, without taking it


@pytest.mark.parametrize(
    ("name", "caps", "length", "direction"),
    [
        ("sg_in", "cyclic residue", (1 << 26) - 4, "s2mm"),
        ("simple_out", "cyclic simple", (1 << 14) - 4, "mm2s"),
        ("simple_in", "cyclic residue simple", (1 << 14) - 4, "s2mm"),
        ("vdma_in", "video", (1 << 23) - 4, "s2mm"),
        ("mc_in0", "cyclic residue", (1 << 26) - 4, "s2mm"),
    ],
)
def test_sysfs_says_what_a_channel_can_do(name: str, caps: str, length: int, direction: str) -> None:
    folder = Path("/sys/class/cm_dma", f"cm_dma!{name}")
    told = [(folder / file).read_text().strip() for file in ("caps", "max_length", "direction", "coherent")]
    assert told == [caps, str(length), direction, "0"]


# T7, T10: what an overlay brings


def test_a_window_that_does_not_begin_at_a_page_is_read_at_its_address() -> None:
    found = device.find_uio(0x58042104, 4, "/")
    assert found[0].name == "odd"
    with device.Uio.open(0x58042104) as uio:
        assert (uio.maps[0].address, uio.maps[0].offset) == (0x58042100, 0x100)
        uio.write(0x4, 0x1234)
        assert uio.read(0x4) == 0x1234
        with pytest.raises(device.DeviceInvalid):
            uio.read(0xF00)  # beyond its page
