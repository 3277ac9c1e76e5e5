# SPDX-License-Identifier: Apache-2.0
"""A simulated board that is stopped: the manager goes on, reports it, and uses it again when it answers."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from manager_process import Manager, environment, served, until

import cm
from cm.client.errors import RequestFailed, TransferFailed
from cm.errors import CmError, Timeout
from cm.simulation.software import Board as SimBoard

LIMIT = 3  # seconds: CM_NODE_TIMEOUT_MS where CM_SIM_TIMEOUT says nothing better
TIMES = 12  # requests in a row: if each waited for the board, they would take that many times LIMIT
Own = tuple[Manager, SimBoard]


@pytest.fixture(scope="module")
def own() -> Iterator[Own]:
    """A manager and a board that no other test needs."""
    with served(env=environment() | {"CM_SIM_TIMEOUT": str(LIMIT)}) as both:
        yield both


@pytest.fixture
def board(own: Own) -> Iterator[cm.Board]:
    """The camera example in its default mode."""
    with own[0].connected() as connected:
        connected.load("camera", "default", force=True)
        yield connected


@contextlib.contextmanager
def stopped(sim: SimBoard) -> Iterator[None]:
    """Stop the board's process, as under a debugger."""
    os.kill(sim.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(sim.pid, signal.SIGCONT)


def at_once(call: Callable[[], object]) -> None:
    """Check that none of many calls waits for the board: a third of the time of all waits is enough anywhere."""
    begun = time.monotonic()
    for _ in range(TIMES):
        call()
    assert time.monotonic() - begun < TIMES * LIMIT / 3


def answers(board: cm.Board) -> None:
    assert board.status.config_name == "camera"


def again(call: Callable[[], object]) -> None:
    """Wait until it answers again."""

    def done() -> bool:
        try:
            call()
        except Timeout:
            return False
        return True

    until(done)


def test_registers_fail_after_a_time_out_and_then_at_once(board: cm.Board, own: Own) -> None:
    board.registers["focus"] = 2
    with stopped(own[1]):

        def write() -> None:
            with pytest.raises(Timeout, match="0x5"):
                board.registers["focus"] = 5

        write()
        at_once(write)
        at_once(lambda: answers(board))
    again(lambda: board.registers.write({"focus": 7}))
    assert board.registers["focus"] == 7


def test_a_writer_gets_an_error_and_writes_again(board: cm.Board, own: Own) -> None:
    board.load("camera", "loopback")
    picture = np.full((480, 640), 9, np.uint8)
    with board.stream("from_pl", timeout=60) as reader, board.writer("to_pl", timeout=60) as writer:
        writer.write(picture)
        assert (reader.read() == 9).all()
        with stopped(own[1]):
            writer.write(picture)
            with pytest.raises(TransferFailed):
                writer.flush(timeout=60)
            with pytest.raises(RequestFailed, match="does not answer"):
                board.write("to_pl", picture)
        until(lambda: not writer.poll() and writer.free > 0)
        writer.write(picture)
        assert (reader.read() == 9).all()


def test_a_change_of_mode_ends_too(board: cm.Board, own: Own) -> None:
    board.registers["focus"] = 2
    with stopped(own[1]):
        with pytest.raises(CmError):
            board.load("camera", "edge_detection")
        answers(board)
    again(lambda: board.registers.write({"scratch": 1}))
    board.load("camera", "edge_detection", force=True)
    assert (board.mode, board.status.fpga_busy) == ("edge_detection", False)
    assert board.read("camera", timeout=60).shape == (480, 640)
