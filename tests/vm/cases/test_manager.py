# SPDX-License-Identifier: Apache-2.0
"""The configuration manager on real device nodes: modes, registers, streams, interrupts, and being killed."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from boardfile import write_bitstreams
from served import OVERLAYS, Manager, loads, pl, until

import cm
from cm import device
from cm.errors import CmError

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
CHANGES = int(os.environ.get("CM_VM_CHANGES", "100"))


@pytest.fixture(scope="module")
def manager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Manager]:
    write_bitstreams()
    served = Manager(tmp_path_factory.mktemp("cm")).start()
    yield served
    served.stop()


@pytest.fixture
def board(manager: Manager) -> Iterator[cm.Board]:
    if manager.process is None:
        manager.start()
    with manager.connected() as connected:
        connected.load("camera", "default")
        yield connected


@pytest.fixture
def fast_port() -> Iterator[None]:
    delay = pl("icap", "delay_us")
    before = delay.read_text()
    delay.write_text("0")
    yield
    delay.write_text(before)


def test_a_mode_loads_its_bitstream_through_the_port(board: cm.Board) -> None:
    before = loads()
    board.mode = "edge_detection"
    assert board.mode == "edge_detection"
    assert loads() == before + 1
    assert board.registers["threshold"] == 7  # the default is written when the mode is entered


def test_the_same_mode_again_loads_nothing(board: cm.Board) -> None:
    before = loads()
    board.mode = "default"
    assert loads() == before


def test_a_register_keeps_what_was_written(board: cm.Board) -> None:
    board.registers["focus"] = 9
    assert board.registers["focus"] == 9


def test_camera_frames_come_by_dma(board: cm.Board) -> None:
    with board.stream("camera", timeout=30) as stream:
        board.configure_stream("camera", enable=True)
        first, second = stream.read(), stream.read()
    assert first.shape == (48, 64)
    words = np.ascontiguousarray(first).view("<u4").ravel()
    assert np.array_equal(words, words[0] + np.arange(len(words), dtype=np.uint32))  # cm_plsim's picture
    assert second.sequence > first.sequence


def test_frames_go_through_the_loop_unchanged(board: cm.Board) -> None:
    board.mode = "loopback"
    sent = np.random.default_rng(1).integers(0, 256, (48, 64), np.uint8)
    with board.stream("from_pl", timeout=30) as stream:
        board.configure_stream("from_pl", enable=True)
        board.write("to_pl", sent)
        assert np.array_equal(stream.read(), sent)


def test_an_interrupt_is_told(board: cm.Board) -> None:
    before = board.interrupts["frame_done"].count
    board.registers["doorbell"] = 1
    assert until(lambda: board.interrupts["frame_done"].count) > before


def test_a_failed_load_goes_back_to_the_mode_before(board: cm.Board) -> None:
    pl("icap", "inject_errors").write_text("1")  # CM_ICAP_ERR_CRC
    with pytest.raises(CmError):
        board.mode = "edge_detection"
    assert (board.mode, board.status.fpga_busy) == ("default", False)
    board.mode = "edge_detection"


def test_a_dma_error_is_told_and_the_stream_goes_on(board: cm.Board) -> None:
    with board.stream("camera", timeout=30) as stream:
        board.configure_stream("camera", enable=True)
        stream.read()
        pl("camera", "fail_next").write_text("1")
        until(lambda: pl("camera", "fail_next").read_text().strip() == "0")
        assert stream.read().shape == (48, 64)


def test_a_manager_killed_during_dma_leaves_nothing_behind(manager: Manager, board: cm.Board) -> None:
    board.configure_stream("camera", enable=True)
    board.read("camera", timeout=30)
    manager.kill()
    manager.start()
    with manager.connected() as again:
        assert again.mode == "default"
        again.configure_stream("camera", enable=True)
        assert again.read("camera", timeout=30).shape == (48, 64)


def test_a_manager_killed_during_a_load_finds_the_board(manager: Manager, board: cm.Board) -> None:
    delay = pl("icap", "delay_us")
    before = delay.read_text()
    delay.write_text("1500000")  # less than the port's patience
    try:
        with device.Icap.open() as port:
            board.load_async(mode="edge_detection")
            until(lambda: port.status().state is device.IcapState.LOADING)
            manager.kill()
            until(lambda: port.status().state is device.IcapState.IDLE)
    finally:
        delay.write_text(before)
    manager.start()
    with manager.connected() as again:
        again.load("camera", "edge_detection")
        assert again.mode == "edge_detection"
        assert not any(region.state == "error" for region in again.status.regions)


def test_a_module_in_use_cannot_be_unloaded(board: cm.Board) -> None:
    board.configure_stream("camera", enable=True)
    board.read("camera", timeout=30)
    done = subprocess.run(["rmmod", "cm_dma"], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert Path("/sys/module/cm_dma").exists()
    board.read("camera", timeout=30)


@pytest.mark.needs("overlay")
def test_an_overlay_of_the_mode_is_in_the_live_tree(board: cm.Board) -> None:
    node = Path("/proc/device-tree/pl-bus/fpga-region-prr0/camera@58002000")
    assert node.exists()
    assert any(path.name.endswith("camera") for path in OVERLAYS.iterdir())
    bound = Path("/sys/bus/platform/devices/58002000.camera/driver")
    assert bound.readlink().name == "uio_pdrv_genirq"
    board.mode = "colorise"  # which names no overlay
    assert not node.exists()
    assert not bound.exists()


@pytest.mark.timeout(600)
def test_many_changes_in_a_row(board: cm.Board, fast_port: None) -> None:
    before = loads()
    modes = ("edge_detection", "default")
    for number in range(CHANGES):
        board.load(mode=modes[number % 2])
    assert loads() == before + CHANGES
    assert board.status.last_error is None
