# SPDX-License-Identifier: Apache-2.0
"""A bridge's core against a manager on a simulated board: records as things happen, and requests back."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from manager_process import Manager
from manager_process import until as until_true

import cm
from cm.client.errors import RequestFailed
from cm.errors import CmError
from cm.networks.bridge.commands import WRITES, Commands
from cm.networks.bridge.follower import Follower
from cm.networks.bridge.records import Caller, ConfigRecord, FrameRecord
from cm.networks.bridge.streams import FrameReader
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import Irq, RegValues, Status

US = Caller()
PATIENCE = 60.0


class Told:
    """A sink that keeps its records."""

    def __init__(self) -> None:
        self.events: queue.Queue[tuple[str, Any]] = queue.Queue()

    def link(self, board: cm.Board | None, problem: str) -> None:
        self.events.put(("link", problem if board is None else ""))

    def status(self, status: Status, stamp_ns: int) -> None:
        self.events.put(("status", status))

    def config(self, record: ConfigRecord) -> None:
        self.events.put(("config", record))

    def registers(self, values: RegValues, stamp_ns: int) -> None:
        self.events.put(("registers", values))

    def interrupt(self, irq: Irq, stamp_ns: int) -> None:
        self.events.put(("interrupt", (irq, stamp_ns)))

    def until(self, kind: str, fits: Any = lambda _: True) -> Any:
        """The first event of that kind for which `fits` is true; earlier ones are dropped."""
        while True:
            name, record = self.events.get(timeout=PATIENCE)
            if name == kind and fits(record):
                return record


@contextmanager
def following(manager: Manager, patience: float = 30.0) -> Iterator[Told]:
    told = Told()
    follower = Follower(lambda: cm.connect(runtime_dir=manager.runtime, timeout=30), told, patience)
    thread = threading.Thread(target=follower.run)
    thread.start()
    try:
        yield told
    finally:
        follower.stop()
        thread.join(PATIENCE)
    assert not thread.is_alive()


@pytest.fixture
def commands(manager: Manager) -> Iterator[Commands]:
    made = Commands(lambda guest: cm.connect(runtime_dir=manager.runtime, timeout=30), WRITES)
    yield made
    made.close()


def test_a_follower_reports_the_present_state_and_then_changes(manager: Manager, board: cm.Board) -> None:
    with following(manager) as told:
        assert told.until("link") == ""
        first = told.until("config")
        assert first.config.mode == "default"
        assert first.stream("camera").encoding == "mono8"
        board.mode = "colorise"
        there = told.until("config", lambda record: record.config.mode == "colorise")
        assert there.stream("camera").encoding == "rgb8"
        assert "palette" in [register.name for register in there.registers]
        board.registers["focus"] = 3
        written = told.until("registers")
        assert [(value.name, value.value) for value in written.values] == [("focus", 3)]


def test_an_interrupt_is_reported_with_wall_time(manager: Manager, board: cm.Board) -> None:
    before = time.time_ns()
    with following(manager) as told, board.stream("camera", timeout=30) as frames:
        told.until("config")
        frames.read()
        irq, stamp_ns = told.until("interrupt")
    assert irq.name == "frame_done"
    assert before - 10**9 < stamp_ns < time.time_ns() + 10**9


def test_a_manager_that_is_killed_is_reported_and_so_is_its_return(own: tuple[Manager, SimBoard]) -> None:
    manager, _ = own
    with following(manager, patience=2.0) as told:
        before = told.until("status")
        manager.kill()
        assert told.until("link") != ""
        manager.start()
        assert told.until("link", lambda problem: not problem) == ""
        assert told.until("status").started_ns > before.started_ns


def test_frames_come_with_wall_time_encoding_and_coordinates_while_they_are_wanted(
    manager: Manager, board: cm.Board
) -> None:
    found: queue.Queue[tuple[FrameRecord, Any]] = queue.Queue()
    with following(manager) as told:
        camera = told.until("config").stream("camera")
    reader = FrameReader(board, camera, lambda record: found.put((record, record.data.copy())))
    reader.start()
    record, pixels = found.get(timeout=PATIENCE)
    reader.stop()
    assert (record.encoding, record.frame_id, record.step, pixels.shape) == ("mono8", "camera", 640, (480, 640))
    assert abs(record.stamp_ns - time.time_ns()) < 600 * 10**9
    until_true(lambda: not next(s for s in board.status.streams if s.name == "camera").open, 30)


def test_a_reader_goes_on_after_the_mode_has_changed_the_shape(manager: Manager, board: cm.Board) -> None:
    found: queue.Queue[str] = queue.Queue()
    with following(manager) as told:
        camera = told.until("config").stream("camera")
    reader = FrameReader(board, camera, lambda record: found.put(record.encoding))
    reader.start()
    assert found.get(timeout=PATIENCE) == "mono8"
    board.mode = "colorise"
    until_true(lambda: found.get(timeout=PATIENCE) == "rgb8", PATIENCE)
    reader.stop()


def test_a_frame_that_is_not_taken_ends_no_reader(manager: Manager, board: cm.Board) -> None:
    found: queue.Queue[int] = queue.Queue()
    failures = iter([ValueError("of another shape than was announced")])

    def take(record: FrameRecord) -> None:
        for failure in failures:
            raise failure
        found.put(record.step)

    with following(manager) as told:
        camera = told.until("config").stream("camera")
    reader = FrameReader(board, camera, take)
    reader.start()
    assert found.get(timeout=PATIENCE) == 640
    reader.stop()


def test_requests_are_carried_out_and_refusals_are_errors(board: cm.Board, commands: Commands) -> None:
    steps: list[str] = []
    assert commands.plan(US, mode="edge_detection").bytes > 0
    assert commands.change(US, mode="edge_detection", progress=lambda at: steps.append(at.step)) > 0
    assert "load" in steps
    assert commands.board(US).status.mode == "edge_detection"
    values = commands.write_registers(US, {"focus": 5, "led": 0xFF, "led.blink": "fast"}, {"led": 0x0F}).values
    assert board.registers["focus"] == 5
    assert board.registers["led.blink"] == 2
    assert len(values) == 3
    assert {value.name for value in commands.read_registers(US, "focus", "zoom").values} == {"focus", "zoom"}
    with pytest.raises(CmError, match="15"):
        commands.write_registers(US, {"focus": 99})
    with pytest.raises(RequestFailed):
        commands.change(US, mode="nowhere")


def test_a_lease_of_the_caller_is_carried_through(board: cm.Board, commands: Commands) -> None:
    with board.lease("board", seconds=60) as lease:
        with pytest.raises(CmError, match="pid"):
            commands.write_registers(US, {"focus": 1})
        assert commands.write_registers(Caller(lease=lease.id), {"focus": 1}).values[0].value == 1


def test_frames_are_written_to_the_hardware(board: cm.Board, commands: Commands) -> None:
    board.mode = "loopback"
    picture = np.random.default_rng(1).integers(0, 255, (480, 640), np.uint8)
    writer = commands.writer(US, "to_pl")
    with board.stream("from_pl", timeout=30) as back:
        writer.write(picture)
        assert np.array_equal(back.read(), picture)
        writer.write(np.asfortranarray(picture))
        assert np.array_equal(back.read(), picture)
    with pytest.raises(CmError, match="307200"):
        writer.write(picture[:10])
    writer.close()
