# SPDX-License-Identifier: Apache-2.0
"""`cm_data_config`: the settings of a stream, what is refused, and that a refusal changes nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm
from cm.errors import Busy, Timeout
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import StreamStatus

LINES, COLUMNS, STRIDE = 48, 100, 128
PICTURE = np.arange(LINES * COLUMNS, dtype=np.uint32).astype(np.uint8).reshape(LINES, COLUMNS)


def state(board: cm.Board, name: str) -> StreamStatus:
    return next(s for s in board.status.streams if s.name == name)


def settings(board: cm.Board, name: str) -> tuple[Any, ...]:
    """All settings except the slots, of which there are more while somebody reads."""
    s = state(board, name)
    return s.shape, s.dtype, s.cyclic, s.backpressure, s.stride, s.limit, s.open


@pytest.fixture
def loop(board: cm.Board) -> Iterator[cm.Board]:
    """A loop from `to_pl` to `from_pl`; the schema's settings are restored at the end."""
    board.load("camera", "loopback")
    yield board
    board.load("camera", "default")


@pytest.fixture(scope="module")
def vdma() -> Iterator[tuple[Manager, SimBoard]]:
    """A manager whose loop is a VDMA's, and that allocates no buffers except those of streams."""
    with served(["--vdma", "to_pl", "--vdma", "from_pl"], settings="dma: {prefetch_mib: 0}\n") as both:
        yield both


@pytest.fixture
def video(vdma: tuple[Manager, SimBoard]) -> Iterator[cm.Board]:
    """That loop, with the schema's settings."""
    with vdma[0].connected() as board:
        board.load("camera", "default", force=True)
        board.load("camera", "loopback")
        yield board


def small(board: cm.Board, **more: Any) -> None:
    for name in ("to_pl", "from_pl"):
        board.configure_stream(name, shape=(LINES, COLUMNS), **more)


# ---- video frames --------------------------------------------------------------------------


def test_a_vdma_moves_frames_that_are_longer_than_its_longest_line(video: cm.Board) -> None:
    picture = np.arange(480 * 640, dtype=np.uint32).astype(np.uint8).reshape(480, 640)
    with video.stream("from_pl", timeout=60) as reader, video.writer("to_pl", timeout=60) as writer:
        writer.write(picture)
        assert (reader.read() == picture).all()
        video.write("to_pl", picture)
        assert (reader.read() == picture).all()


@pytest.mark.parametrize("board_of", ["video", "loop"])
def test_rows_land_at_the_stride_and_nothing_lands_between(board_of: str, request: pytest.FixtureRequest) -> None:
    board: cm.Board = request.getfixturevalue(board_of)
    small(board, stride=STRIDE)
    assert state(board, "to_pl").stride == STRIDE
    with board.stream("from_pl", timeout=60) as reader, board.writer("to_pl", timeout=60) as writer:
        for _ in range(8):  # every slot twice
            with writer.slot() as array:
                np.frombuffer(array.base, np.uint8)[: (LINES - 1) * STRIDE + COLUMNS] = 0xAA
                array[...] = PICTURE
            frame = reader.read()
            memory = np.frombuffer(frame.base, np.uint8)[: LINES * STRIDE].reshape(LINES, STRIDE)
            assert (memory[:, :COLUMNS] == PICTURE).all()
            assert not memory[:, COLUMNS:].any(), "the space between the lines was written"
            assert frame.strides == (STRIDE, 1)
            del frame, memory


def test_the_frame_stores_of_a_vdma_are_the_slots(video: cm.Board, vdma: tuple[Manager, SimBoard]) -> None:
    small(video)
    before = vdma[1].control.state()["buffers"]
    video.configure_stream("from_pl", slots=11, enable=True)
    assert state(video, "from_pl").slots == 11
    assert vdma[1].control.state()["buffers"] == before + 11
    with video.stream("from_pl", depth=6, timeout=60) as reader, video.writer("to_pl", timeout=60) as writer:
        held = []
        for number in range(6):
            writer.write(np.full((LINES, COLUMNS), number, np.uint8))
            held.append(reader.read())
        assert len({frame.__array_interface__["data"][0] for frame in held}) == 6
        assert [int(frame[0, 0]) for frame in held] == list(range(6))
        del held
    video.configure_stream("from_pl", automatic=True)


# ---- one-shot and cyclic -----------------------------------------------------------------


@pytest.mark.parametrize("board_of", ["video", "loop"])
def test_cyclic_is_switched_on_and_off_again(board_of: str, request: pytest.FixtureRequest) -> None:
    board: cm.Board = request.getfixturevalue(board_of)
    assert board.configure_stream("to_pl", cyclic=True).cyclic is True
    assert board.configure_stream("to_pl", slots=3).cyclic is True, "another setting switched it off"
    with board.stream("from_pl", timeout=60) as reader, board.writer("to_pl", depth=2, timeout=60) as writer:
        for value in (1, 2):
            with writer.slot() as array:
                array[...] = value
            values = (int(frame[7, 7]) for frame in reader)
            assert next(v for v in values if v == value) == value
            assert list(islice(values, 3)) == [value] * 3, "it does not repeat"
    assert board.configure_stream("to_pl", cyclic=False).cyclic is False
    with board.stream("from_pl", timeout=60) as reader, board.writer("to_pl", timeout=60) as writer:
        writer.write(np.full((480, 640), 9, np.uint8))
        assert reader.read()[7, 7] == 9
        with pytest.raises(Timeout):
            reader.read(timeout=0.3)


def test_a_running_cycle_ends_when_it_is_switched_off_by_force(loop: cm.Board) -> None:
    loop.configure_stream("to_pl", cyclic=True)
    with loop.stream("from_pl", timeout=60) as reader, loop.writer("to_pl", depth=2, timeout=60) as writer:
        writer.write(np.full((480, 640), 4, np.uint8))
        assert [int(reader.read(timeout=60)[0, 0]) for _ in range(3)] == [4] * 3
        with pytest.raises(Busy, match="in use"):
            loop.configure_stream("to_pl", cyclic=False)
        loop.configure_stream("to_pl", cyclic=False, force=True)
        with contextlib.suppress(Timeout):
            for _ in range(20):  # frames that were on their way
                reader.read(timeout=0.3)
            raise AssertionError("it still repeats")
        until(lambda: not writer.poll() and writer.geometry is not None and not writer.geometry.cyclic)
        writer.write(np.full((480, 640), 5, np.uint8))
        assert until(lambda: reader.read(timeout=60)[0, 0] == 5)  # one earlier frame may come first


# ---- refusals ------------------------------------------------------------------------------


def test_a_stream_in_use_is_changed_by_force_only_but_any_client_may_set_the_same(loop: cm.Board) -> None:
    with loop.writer("to_pl", timeout=60) as writer, loop.stream("from_pl", timeout=60) as reader:
        for name in ("to_pl", "from_pl"):
            before = settings(loop, name)
            with pytest.raises(Busy, match="in use") as caught:
                loop.configure_stream(name, shape=(LINES, COLUMNS))
            assert caught.value.code == "busy"
            assert settings(loop, name) == before
            loop.configure_stream(name, shape=(480, 640), direction=state(loop, name).direction)
            loop.configure_stream(name, shape=(LINES, COLUMNS), force=True)
        until(lambda: not writer.poll() and writer.geometry is not None and writer.geometry.shape == PICTURE.shape)
        writer.write(PICTURE)
        assert (reader.read() == PICTURE).all()


# ---- what is kept --------------------------------------------------------------------------


def test_backpressure_is_switched_on_and_off(loop: cm.Board) -> None:
    for name in ("from_pl", "to_pl"):
        loop.configure_stream(name, shape=(4096,))
    for switched in (True, False):
        assert loop.configure_stream("from_pl", backpressure=switched).backpressure is switched
        patience = 3.0 if switched else 60.0
        with loop.stream("from_pl", depth=2, timeout=60) as slow, loop.writer("to_pl", patience) as writer:
            sent = 0
            with contextlib.suppress(Timeout):
                while sent < 60:
                    writer.write(np.full(4096, sent, np.uint8))
                    sent += 1
            assert (sent == 60) is not switched, "only with backpressure does the hardware wait"
            assert [int(slow.read()[0]) for _ in range(2)] == [0, 1]
            assert slow.lost == 0


def test_a_stream_is_run_stopped_and_left_to_its_users_again(board: cm.Board, manager: Manager) -> None:
    assert board.configure_stream("camera", enable=True).open is True
    with board.stream("camera", timeout=60) as stream:
        stream.read()
        assert board.configure_stream("camera", enable=False).open is False
        with contextlib.suppress(Timeout):
            for _ in range(20):  # frames that were on their way
                stream.read(timeout=0.5)
            raise AssertionError("it still runs")
        with manager.connected() as other, other.stream("camera", timeout=60) as late:
            with pytest.raises(Timeout, match="it is stopped"):
                late.read(timeout=0.5)
            with pytest.raises(Busy, match="enable"):
                other.read("camera")
            assert board.configure_stream("camera", automatic=True).open is True
            assert late.read(timeout=60).sequence >= 0
        assert stream.read(timeout=60).shape == (480, 640)
    until(lambda: not state(board, "camera").open)


# ---- other ways to say it --------------------------------------------------------------------
