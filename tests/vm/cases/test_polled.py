# SPDX-License-Identifier: Apache-2.0
"""Engines whose interrupts are connected to nothing: the kernel's own xilinx_dma, unmodified, behind cm_intc."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import plsim
import pytest
from axi import SLAVE_ERROR, Engine
from served import PATIENCE, driver, until

from cm import device

pytestmark = pytest.mark.needs("xilinx_dma")
CONTROLLER = "58039004.interrupt-controller"
FRAME = 4096
PAIRS = [
    ("polled_sg_out", "polled_sg_in", Engine("polled-sg")),
    ("polled_simple_out", "polled_simple_in", Engine("polled-simple")),
]


def words(first: int, length: int = FRAME) -> bytes:
    return (np.arange(length // 4, dtype="<u4") + first).tobytes()


@pytest.fixture(scope="module", autouse=True)
def bench() -> Iterator[None]:
    """The engines of silicon-polled-bench.dtso; its removal takes the controller away last."""
    overlays = device.Overlays("/")
    overlays.apply("polled", plsim.overlay("silicon-polled-bench"))
    until(lambda: {"polled_sg_in", "polled_simple_in", "polled_vdma_in"} <= set(device.list_dma()))
    yield
    overlays.remove("polled")
    assert not Path("/sys/bus/platform/devices", CONTROLLER).exists()
    assert "goes before" not in subprocess.run(["dmesg"], capture_output=True, text=True, check=True).stdout


def setting(name: str) -> Path:
    return Path("/sys/bus/platform/devices", CONTROLLER, name)


def looks() -> int:
    """Words of the PL read so far."""
    return int(setting("looks").read_text())


def assert_rests() -> None:
    """The PL is not read: not once in the time of many periods."""
    before = looks()
    assert [looks() for _ in range(300)] == [before] * 300


@pytest.fixture(params=PAIRS, ids=["sg", "simple"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[device.AxiDma, device.AxiDma, Engine]]:
    sends, receives, engine = request.param
    with device.AxiDma.open(sends) as out, device.AxiDma.open(receives) as back:
        yield out, back, engine


Pair = tuple[device.AxiDma, device.AxiDma, Engine]


def test_controller_and_engines_have_their_drivers() -> None:
    assert driver(CONTROLLER) == "cm_polled_intc"
    assert {driver(f"5803{n}000.dma-controller") for n in "9ab"} == {"xilinx-vdma"}


def test_nothing_is_read_before_anything_was_begun() -> None:
    assert_rests()


def test_frames_go_there_and_back_and_the_controller_rests_again(pair: Pair) -> None:
    out, back, _ = pair
    with out.allocate(8 * FRAME) as source, back.allocate(8 * FRAME) as sink:
        for turn in range(25):
            source.array()[:] = np.frombuffer(words(turn, 8 * FRAME), np.uint8)
            for index in range(8):
                back.submit(sink, index * FRAME, FRAME, cookie=index)
            for index in range(8):
                out.submit(source, index * FRAME, FRAME, cookie=index)
            for channel in (out, back):
                done = [channel.wait(PATIENCE) for _ in range(8)]
                assert [(one.cookie, one.status, one.length) for one in done] == [(n, 0, FRAME) for n in range(8)]
            assert sink.array().tobytes() == source.array().tobytes()
    until_rests()


def until_rests() -> None:
    """Two looks that find the engine at rest, and none after them."""
    until(lambda: looks() == looks())
    assert_rests()


def test_a_short_packet_is_told_with_its_length(pair: Pair) -> None:
    out, back, _ = pair
    with out.allocate(FRAME) as source, back.allocate(FRAME) as sink:
        source.array()[:] = np.frombuffer(words(1), np.uint8)
        back.submit(sink, length=FRAME)
        out.submit(source, length=100)
        assert out.wait(PATIENCE).status == 0
        done = back.wait(PATIENCE)
        assert (done.status, done.length) == (0, 100)


def test_simple_mode_refuses_what_its_length_register_does_not_hold() -> None:
    with device.AxiDma.open("polled_simple_out") as out, out.allocate(1 << 15) as buffer:
        assert out.info.max_length == (1 << 14) - 4
        with pytest.raises(device.DeviceError) as refused:
            out.submit(buffer, length=1 << 14)
        assert refused.value.errno == errno.EMSGSIZE


def test_a_frame_of_video_is_received() -> None:
    lines, line = 48, 64
    engine = Engine("polled-vdma")
    with device.AxiDma.open("polled_vdma_in") as channel, channel.allocate(lines * line) as buffer:
        for turn in range(3):
            channel.submit_video(buffer, lines, line, line, cookie=turn)
            engine.give(words(turn, lines * line))
            done = channel.wait(PATIENCE)
            assert (done.cookie, done.status, done.length) == (turn, 0, lines * line)
            assert buffer.array(0, lines * line).tobytes() == words(turn, lines * line)
    assert_rests()


def test_an_error_of_the_engine_ends_the_transfer_that_it_hit(pair: Pair) -> None:
    out, back, engine = pair
    with out.allocate(2 * FRAME) as source, back.allocate(2 * FRAME) as sink:
        engine.inject("mm2s", SLAVE_ERROR)
        for index in range(2):
            back.submit(sink, index * FRAME, FRAME, cookie=index)
        for index in range(2):
            out.submit(source, index * FRAME, FRAME, cookie=index)
        assert [out.wait(PATIENCE).status for _ in range(2)] == [-errno.EIO, 0]
        assert back.wait(PATIENCE).status == 0
        back.cancel()  # the packet that failed does not come


def test_what_waits_is_looked_for_and_what_was_cancelled_is_not(pair: Pair) -> None:
    _, back, _ = pair
    with back.allocate(FRAME) as sink:
        back.submit(sink, length=FRAME)
        before = looks()
        until(lambda: looks() > before + 10)
        back.cancel()
        assert_rests()
        assert back.wait(PATIENCE).status == -errno.ECANCELED


def test_a_reset_of_the_other_channel_leaves_what_this_one_waits_for(pair: Pair) -> None:
    out, back, engine = pair
    with out.allocate(FRAME) as source, back.allocate(FRAME) as sink:
        back.submit(sink, length=FRAME)
        with engine.held("mm2s"):
            out.submit(source, length=FRAME)
            out.cancel()
            assert out.wait(PATIENCE).status == -errno.ECANCELED
        out.submit(source, length=FRAME)
        assert (back.wait(PATIENCE).length, out.wait(PATIENCE).status) == (FRAME, 0)


def test_a_close_under_a_transfer_leaves_nothing_that_looks() -> None:
    back = device.AxiDma.open("polled_sg_in")
    back.submit(back.allocate(FRAME), length=FRAME)
    before = looks()
    until(lambda: looks() > before)
    back.close()
    assert_rests()


def test_the_period_is_a_setting() -> None:
    period = setting("period_us")
    assert period.read_text() == "400\n"  # as its node says
    period.write_text("2000")
    assert period.read_text() == "2000\n"
    for wrong in ("9", "1000001", "soon"):
        with pytest.raises(OSError, match="Invalid argument"):
            period.write_text(wrong)
    period.write_text("400")


def test_a_module_whose_lines_are_taken_stays() -> None:
    removed = subprocess.run(["rmmod", "cm_intc"], capture_output=True, text=True, check=False)
    assert removed.returncode
    assert Path("/sys/module/cm_intc").exists()


def test_an_engine_goes_under_a_transfer_and_comes_back() -> None:
    bound = Path("/sys/bus/platform/drivers/xilinx-vdma")
    engine = "58039000.dma-controller"
    for _ in range(5):
        with device.AxiDma.open("polled_sg_in") as back, back.allocate(FRAME) as sink:
            back.submit(sink, length=FRAME)
            (bound / "unbind").write_text(engine)
            assert_rests()
            with pytest.raises(device.DeviceError):
                back.submit(sink, length=FRAME)
        (bound / "bind").write_text(engine)
        until(lambda: {"polled_sg_in", "polled_sg_out"} <= set(device.list_dma()))
    out, back = device.AxiDma.open("polled_sg_out"), device.AxiDma.open("polled_sg_in")
    with out, back, out.allocate(FRAME) as source, back.allocate(FRAME) as sink:
        back.submit(sink, length=FRAME)
        out.submit(source, length=FRAME)
        assert (back.wait(PATIENCE).length, out.wait(PATIENCE).status) == (FRAME, 0)
