# SPDX-License-Identifier: Apache-2.0
"""Transfers of a client's own memory: no byte is copied, and the stream is that client's alone."""

from __future__ import annotations

import asyncio
import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm.aio
from cm.client.board import Board
from cm.client.errors import TransferFailed
from cm.errors import Busy, InvalidRequest
from cm.simulation.software import Board as SimBoard

SIZE = 4 << 20


@pytest.fixture(scope="module")
def place() -> Iterator[tuple[Manager, SimBoard]]:
    with served() as found:
        yield found


@pytest.fixture(scope="module")
def both(place: tuple[Manager, SimBoard]) -> Iterator[tuple[Board, SimBoard]]:
    with place[0].connected() as board:
        board.load("camera", mode="loopback")
        yield board, place[1]


@pytest.fixture
def board(both: tuple[Board, SimBoard]) -> Board:
    return both[0]


def test_nothing_is_copied_on_the_way(board: Board) -> None:
    source, result = board.allocate(SIZE), board.allocate(SIZE)
    source[:] = np.arange(SIZE, dtype=np.uint8)
    with board.transfers("to_pl") as send, board.transfers("from_pl") as receive:
        tracemalloc.start()
        receive.begin(result)
        send.begin(source)
        send.flush()
        receive.flush()
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        streams = {stream.name: stream for stream in board.status.streams}
    assert (receive.moved, bool((result == source).all())) == (SIZE, True)
    assert {streams["to_pl"].slots, streams["from_pl"].slots} == {0}  # there is no other memory to copy through
    assert most < SIZE // 16


def test_a_task_transfers_while_another_waits(place: tuple[Manager, SimBoard], both: tuple[Board, SimBoard]) -> None:
    async def there_and_back() -> tuple[int, list[int]]:
        async with cm.aio.connect(runtime_dir=place[0].runtime) as board:
            source, result = [await board.allocate(64) for _ in range(2)]
            source[:] = 9
            async with board.transfers("to_pl") as send, board.transfers("from_pl") as receive:
                await receive.begin(result)
                waiting = asyncio.create_task(receive.flush())
                await send.begin(source)
                await asyncio.gather(send.flush(), waiting)
                with pytest.raises(InvalidRequest, match="60 to 68 are not in one piece"):
                    await receive.begin(result, 60, 8)
                return receive.moved, result.tolist()

    assert asyncio.run(there_and_back()) == (64, [9] * 64)


def test_four_are_under_way_and_a_part_leaves_the_rest_alone(board: Board) -> None:
    source, result = board.allocate(4096), board.allocate(4096)
    source[:] = np.arange(4096) % 251
    with board.transfers("to_pl") as send, board.transfers("from_pl") as receive:
        for part in range(4):
            receive.begin(result, 1000 * part + 10, 500)
        for part in range(4):
            send.begin(source, 7 * part, 400 + part)
        receive.flush()
        assert receive.moved == 403  # a packet may be shorter
    for part in range(4):
        there = 1000 * part + 10
        assert (result[there : there + 400 + part] == source[7 * part : 7 * part + 400 + part]).all()
        assert not result[there + 400 + part : there + 1000].any()


def test_a_stream_has_one_kind_of_client_at_a_time(board: Board) -> None:
    with board.transfers("from_pl"):
        for other in (
            lambda: board.transfers("from_pl"),
            lambda: board.stream("from_pl").read(),
            lambda: board.read("from_pl"),
        ):
            with pytest.raises(Busy, match="'from_pl' is in use"):
                other()
    with board.stream("from_pl"), pytest.raises(Busy, match="'from_pl' is in use by pid"):
        board.transfers("from_pl")
    with board.stream("from_pl") as frames, board.writer("to_pl") as writer:
        writer.write(np.zeros(writer.geometry.shape if writer.geometry else (), np.uint8))
        assert frames.read().nbytes > 0
    with board.transfers("from_pl") as receive:
        assert receive.under_way == 0


@pytest.mark.parametrize(("start", "nbytes"), [(0, 65), (64, 0), (-1, 4), (0, -8)])
def test_bytes_that_are_not_the_arrays_are_refused(board: Board, start: int, nbytes: int) -> None:
    with board.transfers("to_pl") as send, pytest.raises(InvalidRequest, match="array of 64 bytes"):
        send.begin(board.allocate(64), start, nbytes)


def test_more_than_the_engine_moves_at_once_is_refused_with_the_reason(board: Board) -> None:
    source = board.allocate(1 << 26)
    with (
        board.transfers("to_pl") as send,
        pytest.raises(InvalidRequest, match="67108864 bytes; the engine moves 671088"),
    ):
        send.begin(source)


def test_after_a_change_of_mode_it_goes_on(board: Board) -> None:
    source, result = board.allocate(64), board.allocate(64)
    with board.transfers("to_pl") as send, board.transfers("from_pl") as receive:
        receive.begin(result)
        board.load("camera", mode="loopback", force=True)
        with pytest.raises(
            TransferFailed, match="'from_pl': a transfer failed after 0 of 64 bytes: Operation canceled"
        ):
            receive.flush()
        source[:] = 5
        receive.begin(result)
        send.begin(source)
        receive.flush()
        assert result.tolist() == [5] * 64


def test_memory_is_given_back_when_it_is_freed_between_transfers(both: tuple[Board, SimBoard]) -> None:
    board, sim = both
    before = sim.control.state()["memory"]
    with board.transfers("to_pl") as send, board.transfers("from_pl") as receive:
        for value in range(70):  # more than the channel knows at once
            source, result = board.allocate(64), board.allocate(64)
            source[:] = value
            receive.begin(result)
            send.begin(source)
            send.flush()
            receive.flush()
            assert result.tolist() == [value] * 64
            source.free()
            result.free()
    assert until(lambda: sim.control.state()["memory"] <= before)
