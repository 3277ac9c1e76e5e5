# SPDX-License-Identifier: Apache-2.0
"""Registers requested repeatedly with the same bytes: the manager has a fast path, with the same answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
import zmq
from manager_process import Manager, until

import cm
from cm.simulation.software import Board as SimBoard
from cm.wire import cm_pb2 as pb

Ask = Callable[..., pb.Reply]
TIMES = 3  # the first answer takes the slow path


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


def asking(stack: ExitStack, manager: Manager) -> Ask:
    socket = stack.enter_context(stack.enter_context(zmq.Context()).socket(zmq.REQ))
    socket.linger, socket.rcvtimeo = 0, 60_000
    socket.connect(f"ipc://{manager.runtime}/req")

    def ask(*names: str) -> pb.Reply:
        socket.send_multipart([b"cm_read_reg", pb.ReadReg(names=names).SerializeToString()])
        topic, message = socket.recv_multipart()
        assert topic == b"cm_read_reg"
        return pb.Reply.FromString(message)

    return ask


def test_no_answer_comes_from_a_region_that_is_being_loaded(
    board: cm.Board, manager: Manager, stack: ExitStack
) -> None:
    ask = asking(stack, manager)
    assert [ask("focus").ok for _ in range(TIMES)] == [True] * TIMES
    for mode in ("edge_detection", "default") * 5:
        codes = set()
        while "region_busy" not in codes:  # a load may be over before we have had our turn
            change = board.load_async("camera", mode, force=True)
            while not change.done:
                reply = ask("focus")
                codes.add(reply.error.code)
                assert reply.ok or reply.error.code == "region_busy"
            change.wait(60)
    assert ask("focus").registers.mode == "default"


def test_a_board_that_is_gone_is_reported_and_the_next_one_is_read(
    own: tuple[Manager, SimBoard], stack: ExitStack
) -> None:
    manager, sim = own
    ask = asking(stack, manager)
    with manager.connected() as board:
        board.load("camera", "default")
        board.registers["focus"] = 5
        assert [ask("focus").registers.values[0].value for _ in range(TIMES)] == [5] * TIMES
        sim.kill()
        until(lambda: not ask("focus").ok)
        sim.restart()
        until(lambda: board.status.config_name == "")
        assert ask("focus").error.code == "nothing_loaded"
        board.load("camera", "default")
        assert [ask("focus").registers.values[0].value for _ in range(TIMES)] == [1] * TIMES
