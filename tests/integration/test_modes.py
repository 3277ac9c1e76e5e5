# SPDX-License-Identifier: Apache-2.0
"""Modes, registers, streams and interrupts through the public client."""

from __future__ import annotations

import asyncio
import gc
import warnings
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from manager_process import CAMERA, Manager, patient, served, stalled, until
from reference import sobel

import cm
from cm.client.errors import RequestBusy, RequestFailed, RequestInvalid, RequestNotFound
from cm.errors import Timeout
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.hardware.camera import shipped_photos


def test_loading_enters_the_default_mode(board: cm.Board) -> None:
    assert (board.status.config_name, board.mode) == ("camera", "default")


def test_the_default_frame_is_the_photograph(board: cm.Board) -> None:
    frame = board.read("camera", timeout=60)
    assert any(np.array_equal(frame, photo) for photo in shipped_photos().values())


def test_the_edge_frame_equals_a_reference_sobel(board: cm.Board) -> None:
    board.mode = "edge_detection"
    frame = board.read("camera", timeout=60)
    assert any(np.array_equal(frame, sobel(photo)) for photo in shipped_photos().values())


def test_a_module_is_no_mode_but_in_plain_text(board: cm.Board) -> None:
    with pytest.raises(RequestNotFound, match="no mode 'edge'; mode 'edge_detection' has that module alone"):
        board.mode = "edge"


def test_a_frame_carries_the_mode_it_was_made_in(board: cm.Board) -> None:
    board.mode = "colorise"
    frame = board.read("camera", timeout=60)
    assert (frame.info.mode, frame.shape, frame.dtype) == ("colorise", (480, 640, 3), np.uint8)


def test_a_stream_numbers_its_frames(board: cm.Board) -> None:
    with board.stream("camera", depth=5, timeout=60) as stream:
        numbers = [frame.sequence for frame in islice(stream, 5)]
    assert numbers == list(range(numbers[0], numbers[0] + 5))


def test_frames_go_through_the_loop_unchanged(board: cm.Board) -> None:
    board.mode = "loopback"
    sent = np.arange(480 * 640, dtype=np.uint32).astype(np.uint8).reshape(480, 640)
    with board.stream("from_pl", timeout=60) as stream:
        board.configure_stream("from_pl", enable=True)
        board.write("to_pl", sent)
        assert np.array_equal(stream.read(), sent)


def test_a_stream_of_another_region_runs_while_one_is_reconfigured(tmp_path: Path) -> None:
    with served(schemas=patient(tmp_path)) as (manager, sim), manager.connected() as board:
        board.load("camera", "default")
        board.load(mode="loopback")
        board.configure_stream("from_pl", enable=True)
        with stalled(sim):
            change = board.load_async(mode="edge_detection")
            until(lambda: any(r.state == "loading" for r in board.status.regions))
            for _ in range(5):
                board.write("to_pl", np.zeros((480, 640), np.uint8))
            assert any(r.state == "loading" for r in board.status.regions)
        change.wait(60)
        assert board.mode == "edge_detection"


def test_a_change_that_is_not_waited_for_leaves_no_socket(board: cm.Board) -> None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        board.load_async(mode="edge_detection")
        until(lambda: board.mode == "edge_detection")
        gc.collect()
        assert [str(warning.message) for warning in warned] == []


def test_a_register_keeps_what_was_written(board: cm.Board) -> None:
    board.registers["focus"] = 2
    assert board.registers["focus"] == 2


def test_fields_and_masks_change_their_bits_only(board: cm.Board) -> None:
    board.registers["scratch"] = 0xF0F0
    assert board.registers.write_masked("scratch", 0x0005, 0x000F) == 0xF0F5


def test_a_wrong_write_in_a_list_leaves_all_registers_alone(board: cm.Board) -> None:
    with pytest.raises(RequestInvalid, match="outside 0 to 15"):
        board.registers.write({"scratch": 77, "focus": 200})
    assert board.registers["scratch"] != 77


def test_a_read_only_register_cannot_be_written(board: cm.Board) -> None:
    with pytest.raises(RequestInvalid, match="read-only"):
        board.registers["version"] = 1


def test_the_error_for_a_register_of_another_mode_names_that_mode(board: cm.Board) -> None:
    with pytest.raises(RequestNotFound, match="modes edge_detection have it"):
        _ = board.registers["threshold"]


def test_a_misspelt_mode_gets_a_suggestion(board: cm.Board) -> None:
    with pytest.raises(RequestNotFound, match="did you mean 'colorise'"):
        board.mode = "colorize"


def test_a_register_takes_effect_on_the_picture(board: cm.Board) -> None:
    before = board.read("camera", timeout=60).copy()
    board.registers["focus"] = 6
    after = board.read("camera", timeout=60)
    assert np.abs(np.diff(after.astype(int))).mean() < np.abs(np.diff(before.astype(int))).mean()


def test_interrupts_are_counted_and_fanned_out(board: cm.Board, manager: Manager) -> None:
    board.configure_stream("camera", enable=True)
    with manager.connected() as other:
        first = board.interrupts["frame_done"].events(timeout=60)
        second = other.interrupts["frame_done"].events(timeout=60)
        assert next(first).count > 0
        assert next(second).count > 0


def test_interrupts_arrive_while_another_client_holds_the_board(board: cm.Board, manager: Manager) -> None:
    board.configure_stream("camera", enable=True)
    with manager.connected() as other, other.lease("board"):
        events = board.interrupts["frame_done"].events(timeout=30)
        counts = [next(events).count for _ in range(5)]
    assert counts == sorted(set(counts))


def test_an_interrupt_that_does_not_come_times_out(board: cm.Board) -> None:
    done = board.interrupts["loop_done"]
    if done.count:
        done.wait(timeout=60)  # of another test's frame: what came before this wait is over
    with pytest.raises(Timeout):
        done.wait(timeout=0.2)


def test_a_plan_says_what_would_be_loaded_and_touches_nothing(board: cm.Board) -> None:
    plan = board.plan("edge_detection")
    assert [s.kind for s in plan.steps][:4] == ["validate", "quiesce", "decouple", "load"] or "load" in [
        s.kind for s in plan.steps
    ]
    assert plan.bytes > 0
    assert board.mode == "default"


def test_a_change_to_the_present_mode_does_nothing(board: cm.Board) -> None:
    assert board.plan("default").steps == ()


def test_progress_is_reported_while_loading(board: cm.Board) -> None:
    steps: list[str] = []
    board.load(mode="edge_detection", progress=lambda p: steps.append(p.step))
    assert {"validate", "load", "publish"} <= set(steps)


def test_a_late_subscriber_gets_the_status_at_once(board: cm.Board) -> None:
    assert next(board.watch(timeout=60)).mode == "default"


def test_a_lease_keeps_others_off(board: cm.Board, manager: Manager) -> None:
    with cm.connect(runtime_dir=manager.runtime, timeout=60) as other, board.lease("region:prr0") as lease:
        with pytest.raises(RequestBusy, match="held by"):
            other.mode = "edge_detection"
        other.load(mode="edge_detection", lease=lease.id)
        board.mode = "default"  # the holder's own calls pass
    board.mode = "edge_detection"
    board.mode = "default"


def test_a_wrongly_sized_frame_is_refused(board: cm.Board) -> None:
    board.mode = "loopback"
    with pytest.raises(RequestInvalid, match="307200 bytes; this one has 10"):
        board.write("to_pl", b"0123456789")


def test_a_configuration_can_be_provisioned_over_the_wire(board: cm.Board, manager: Manager, tmp_path) -> None:  # type: ignore[no-untyped-def]
    schema = tmp_path / "spare.yaml"
    schema.write_text((CAMERA / "camera.yaml").read_text().replace("name: camera", "name: spare", 1))
    firmware = manager.runtime.parent / "board/lib/firmware/cm/camera"
    board.provision(schema, *sorted(firmware.iterdir()))
    board.load("spare", "edge_detection")
    assert board.status.config_name == "spare"


def test_asyncio_twin_does_the_same(board: cm.Board, manager: Manager) -> None:
    async def session() -> tuple[str, int, tuple[int, ...]]:
        async with cm.aio.connect(runtime_dir=manager.runtime, timeout=60) as aboard:
            await aboard.load(mode="edge_detection")
            values = await aboard.registers.write({"focus": 3})
            async for frame in aboard.stream("camera", timeout=60):
                shape = frame.shape
                break
            return (await aboard.status()).mode, values["focus"], shape

    assert asyncio.run(session()) == ("edge_detection", 3, (480, 640))


def test_an_empty_board_is_described_in_words(own: tuple[Manager, SimBoard]) -> None:
    with own[0].connected() as fresh, pytest.raises(RequestFailed, match="nothing is loaded") as caught:
        _ = fresh.registers["focus"]
    assert caught.value.code == "nothing_loaded"


def test_the_first_mode_need_not_name_an_empty_region(own: tuple[Manager, SimBoard]) -> None:
    """Its registers answer for nobody yet; they get their defaults when a module comes."""
    with own[0].connected() as board:
        board.load("camera", "loopback")
        assert board.mode == "loopback"
        with pytest.raises(RequestBusy, match="unknown"):
            _ = board.registers["focus"]
        board.mode = "edge_detection"
        assert board.registers["focus"] == 1
