# SPDX-License-Identifier: Apache-2.0
"""Frames say under which generation of the registers they began, and never a newer one than is true."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import pairwise

import pytest
from manager_process import Manager, served

import cm
from cm.client.stream import Stream


@pytest.fixture(scope="module")
def listening() -> Iterator[Manager]:
    with served(arguments=("--listen", "tcp://127.0.0.1:0", "--insecure")) as (manager, _):
        yield manager


@pytest.fixture(params=["ipc", "tcp"])
def reading(listening: Manager, request: pytest.FixtureRequest) -> Iterator[tuple[cm.Board, Stream]]:
    """A board, and a stream of it by each of the ways."""
    endpoint = {"endpoint": listening.tcp()} if request.param == "tcp" else {"runtime_dir": listening.runtime}
    with cm.connect(timeout=30, **endpoint) as board:
        board.load("camera", "default", force=True)
        with board.stream("camera", timeout=30) as stream:
            yield board, stream


def test_a_frame_is_of_the_writes_that_were_done_when_the_frame_before_it_ended(
    reading: tuple[cm.Board, Stream],
) -> None:
    board, stream = reading
    writes: list[tuple[int, int, int]] = []  # the generation, and the time before and after
    frames: list[tuple[int, int, int]] = []  # sequence, end, generation
    for number in range(20):
        frame = stream.read()
        frames.append((frame.sequence, frame.timestamp_ns, frame.generation))
        frame.release()
        before = time.monotonic_ns()
        written = board.registers.write({"focus": 1 + number % 3})
        writes.append((written.generation, before, time.monotonic_ns()))
    together = [(a, b) for a, b in pairwise(frames) if b[0] == a[0] + 1]
    assert together, "all frames were lost but every second"
    for (_, ended, _), (_, _, generation) in together:
        assert all(begun <= ended for number, begun, _ in writes if number <= generation), "it came later"
        assert all(number <= generation for number, _, done in writes if done <= ended), "it was done by then"
    assert frames[-1][2] >= writes[0][0], "no frame was after a write"


def test_what_the_first_frame_of_a_stream_began_under_is_not_known(board: cm.Board) -> None:
    written = board.registers.write({"focus": 2})
    with board.stream("camera", timeout=30) as stream:
        first, second = stream.read(), stream.read()
        assert first.generation == 0
        assert second.generation == written.generation


def test_a_reader_that_joins_learns_the_generation_that_others_know(board: cm.Board) -> None:
    with board.stream("camera", timeout=30) as before:
        written = board.registers.write({"focus": 3})
        before.after(written)
        with board.stream("camera", timeout=30) as stream:
            assert stream.read().generation == written.generation
