# SPDX-License-Identifier: Apache-2.0
"""The configuration manager on real device nodes: modes, registers, streams, interrupts, and being killed."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from boardfile import FIRMWARE, LENT, write_bitstreams
from served import OVERLAYS, PATIENCE, Manager, driver, loads, pl, until

import cm
from cm import device
from cm.client.errors import WindowRevoked
from cm.errors import CmError
from cm.formats.bitstream import device_by_name, open_image, to_dma_words
from cm.formats.bitstream.geometry import frame_order
from cm.formats.bitstream.memory import frames_of

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


def test_a_memory_holds_an_array_and_registers_see_its_words(board: cm.Board) -> None:
    scratchpad = board.memories["scratchpad"]
    values = np.random.default_rng(3).integers(-30000, 30000, (16, 32)).astype("int16")
    scratchpad.write(values)
    assert np.array_equal(scratchpad.read(), values)
    scratchpad[2:4] = 7
    assert scratchpad[1:4].tolist() == [values[1].tolist(), [7] * 32, [7] * 32]
    with device.Uio.open(0x58001800) as uio:
        assert uio.read(0x800 + 2 * 64) == 0x0007_0007
    board.registers["scratch"] = 5
    assert board.configure_memory("static", 0x58001000, 0x20, access="ro").read().tolist()[5] == 5


def test_mapped_registers_are_taken_back_when_their_region_is_loaded(board: cm.Board) -> None:
    if LENT[0] in {place.address for info in device.list_uio("/") for place in info.maps}:
        pytest.skip("what a device tree lends here are no registers of a mode")
    mode, module, name = "edge_detection", "edge", "threshold"
    board.mode = mode
    with board.registers.window(module, write=True, timeout=PATIENCE) as window:
        window[name] = 5
        assert (window[name], board.registers[name]) == (5, 5)
        assert [held.module for held in until(lambda: board.status.windows)] == [module]
        board.load("camera", mode, force=True)
        with pytest.raises(WindowRevoked) as taken:
            window[name]
    assert taken.value.mode == mode
    until(lambda: not board.status.windows)


def test_a_memory_is_refused_while_no_module_answers_for_it(board: cm.Board) -> None:
    window = board.memories["window"]
    window.write(np.arange(256))
    assert window.read(4, 8).tolist() == [1, 2]
    with pytest.raises(CmError, match="region prr1") as refused:
        board.configure_memory("loop", 0x58001400, 64, region="prr1").read()
    assert refused.value.code == "region_busy"


def test_camera_frames_come_by_dma(board: cm.Board) -> None:
    with board.stream("camera", timeout=PATIENCE) as stream:
        board.configure_stream("camera", enable=True)
        first, second = stream.read(), stream.read()
    assert first.shape == (48, 64)
    words = np.ascontiguousarray(first).view("<u4").ravel()
    assert np.array_equal(words, words[0] + np.arange(len(words), dtype=np.uint32))  # cm_plsim's picture
    assert second.sequence > first.sequence


def test_frames_go_through_the_loop_unchanged(board: cm.Board) -> None:
    board.mode = "loopback"
    sent = np.random.default_rng(1).integers(0, 256, (48, 64), np.uint8)
    with board.stream("from_pl", timeout=PATIENCE) as stream:
        board.configure_stream("from_pl", enable=True)
        board.write("to_pl", sent)
        assert np.array_equal(stream.read(), sent)


def test_an_interrupt_is_reported(board: cm.Board) -> None:
    before = board.interrupts["frame_done"].count
    board.registers["doorbell"] = 1
    assert until(lambda: board.interrupts["frame_done"].count) > before


def test_a_failed_load_goes_back_to_the_mode_before(board: cm.Board) -> None:
    pl("icap", "inject_errors").write_text("1")  # CM_ICAP_ERR_CRC
    with pytest.raises(CmError):
        board.mode = "edge_detection"
    assert (board.mode, board.status.fpga_busy) == ("default", False)
    board.mode = "edge_detection"


@pytest.fixture
def frames() -> list[int]:
    """The frames of the module that the default mode loads, where the port can be read."""
    if not pl("icap", "loads").with_name("upset").exists():
        pytest.skip("this board's port has no way back")
    part = device_by_name("xc7z020")
    assert part is not None
    order = frame_order(part.name, part.family)
    assert order is not None
    # the simulated port counts frames as the device does
    table = b"".join((0xFFFFFFFF if far is None else far).to_bytes(4, "little") for far in order.order)
    pl("icap", "frame_order").write_bytes(table)
    return list(frames_of(open_image((FIRMWARE / "default.bit").read_bytes()), order))


def test_bits_that_turn_over_under_a_region_are_found_and_mended(board: cm.Board, frames: list[int]) -> None:
    assert board.check_region("prr0").verdict == "good"
    for far in (frames[0], frames[-1]):
        pl("icap", "upset").write_text(f"{far:#x} 37")
    found = board.check_region("prr0")
    assert (found.verdict, [(one.far, list(one.bits)) for one in found.wrong]) == (
        "wrong",
        [(frames[0], [37]), (frames[-1], [37])],
    )
    with board.stream("camera", timeout=PATIENCE) as stream:
        board.configure_stream("camera", enable=True)
        stream.read()
        mended = board.check_region("prr0", repair=True)
        assert (mended.verdict, mended.wrong_bits) == ("good", 2)
        stream.read()
    assert board.check_region("prr0").verdict == "good"


def test_a_dma_error_is_reported_and_the_stream_goes_on(board: cm.Board) -> None:
    with board.stream("camera", timeout=PATIENCE) as stream:
        board.configure_stream("camera", enable=True)
        stream.read()
        pl("camera", "fail_next").write_text("1")
        until(lambda: pl("camera", "fail_next").read_text().strip() == "0")
        assert stream.read().shape == (48, 64)


def test_a_manager_killed_during_dma_leaves_nothing_behind(manager: Manager, board: cm.Board) -> None:
    board.configure_stream("camera", enable=True)
    board.read("camera", timeout=PATIENCE)
    manager.kill()
    manager.start()
    with manager.connected() as again:
        assert again.mode == "default"
        again.configure_stream("camera", enable=True)
        assert again.read("camera", timeout=PATIENCE).shape == (48, 64)


def test_a_manager_killed_during_a_load_finds_the_board(manager: Manager, board: cm.Board) -> None:
    delay = pl("icap", "delay_us")
    before = delay.read_text()
    delay.write_text("1000000")  # half of the patience of a port whose node says none
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
    board.read("camera", timeout=PATIENCE)
    done = subprocess.run(["rmmod", "cm_dma"], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert Path("/sys/module/cm_dma").exists()
    board.read("camera", timeout=PATIENCE)


@pytest.mark.needs("overlay", "board_overlay")
def test_overlays_of_a_mode_are_in_the_live_tree_and_their_drivers_bound(board: cm.Board) -> None:
    camera = Path("/proc/device-tree/pl-bus/fpga-region-0/camera@58002000")
    leds = Path("/proc/device-tree/pl-bus/leds@58004000")
    assert (camera.exists(), leds.exists()) == (True, False)
    assert (driver("58002000.camera"), driver("58004000.leds")) == ("cm_window", None)
    board.mode = "colorise"  # which has one more
    assert (camera.exists(), leds.exists()) == (True, True)
    assert driver("58004000.leds") == "uio_pdrv_genirq"
    board.mode = "loopback"  # which has none
    assert (camera.exists(), leds.exists()) == (False, False)
    assert (driver("58002000.camera"), driver("58004000.leds")) == (None, None)
    assert not [path.name for path in OVERLAYS.iterdir() if path.name != "static"]


def noticed(board: cm.Board) -> str:
    """What the status says of another program that loaded the PL, or took an overlay away, once it does."""
    until(lambda: board.status.last_error and board.status.last_error.code == "other_loader")
    assert board.status.last_error is not None
    return board.status.last_error.message


@pytest.mark.needs("overlay", "fpga", "board_overlay")
def test_what_another_program_loads_is_noticed_and_nothing_is_served_of_it(board: cm.Board) -> None:
    board.mode = "loopback"  # which has no overlays: the other program's finds the region free
    (FIRMWARE / "edge.bit.bin").write_bytes(to_dma_words((FIRMWARE / "edge.bit").read_bytes()))
    overlays, before = device.Overlays("/"), loads()
    overlays.apply("app", (FIRMWARE / "edge.dtbo").read_bytes())  # as `xmutil loadapp`
    try:
        assert "overlay app was applied, which loads one" in noticed(board)
        assert (board.status.mode, {region.state for region in board.status.regions}) == ("", {"unknown"})
        with pytest.raises(CmError, match="overlay app was applied"):
            board.registers["scratch"]
        assert loads() == before + 1, "the manager fights with nobody"
    finally:
        overlays.remove("app")
    board.load("camera", "default")
    assert board.registers["focus"] == 1


@pytest.mark.needs("overlay", "board_overlay")
def test_an_overlay_that_another_program_takes_away_ends_the_mode(board: cm.Board) -> None:
    name = next(path.name for path in OVERLAYS.iterdir() if path.name != "static")
    device.Overlays("/").remove(name)
    assert f"overlay {name} was removed" in noticed(board)
    assert board.status.mode == ""
    board.load("camera", "default")
    assert driver("58002000.camera") == "cm_window"


def open_files(manager: Manager) -> int:
    return len(list(Path(f"/proc/{manager.pid}/fd").iterdir()))


@pytest.mark.parametrize("hundred", range(CHANGES // 100 or 1))
def test_many_changes_in_a_row(manager: Manager, board: cm.Board, fast_port: None, hundred: int) -> None:
    """In hundreds, so that the time-out is one of a hundred and somebody sees it go on."""
    count = min(CHANGES, 100)
    for mode in ("edge_detection", "default"):  # what is opened once is open now
        board.load(mode=mode)
    for _ in range(100):  # and what pyzmq opens for replies of which it tells when they have left: one in 16 KiB
        board.clients()
    before = loads()
    files = open_files(manager)
    for number in range(count):
        board.load(mode=("edge_detection", "default")[number % 2])
    assert loads() == before + count
    assert board.status.last_error is None
    assert until(lambda: open_files(manager) <= files)  # it notices a client's end a little later
