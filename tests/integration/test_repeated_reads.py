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


@pytest.fixture
def ask(board: cm.Board, manager: Manager, stack: ExitStack) -> Ask:
    """Reads registers over a socket of its own, with the manager in the example's default mode."""
    return asking(stack, manager)


@pytest.mark.parametrize(
    "names",
    [
        ("focus",),
        ("led",),
        ("led.blink", "zoom", "focus"),
        ("focus", "focus"),
    ],
)
def test_the_same_question_gets_the_same_answer(ask: Ask, board: cm.Board, names: tuple[str, ...]) -> None:
    board.registers["led"] = 0x2A
    replies = [ask(*names) for _ in range(TIMES)]
    assert replies[0].ok
    assert all(reply.registers == replies[0].registers for reply in replies)
    if "led" in names:
        assert dict(replies[-1].registers.values[0].fields) == {"pattern": 0xA, "blink": 2}


def test_every_answer_holds_the_value_of_its_time(ask: Ask, board: cm.Board) -> None:
    for value in (3, 1, 7, 2):
        board.registers["focus"] = value
        assert [v.value for v in ask("focus").registers.values] == [value]


@pytest.mark.parametrize(
    ("names", "code"), [(("threshold",), "unknown_register"), (("focus", "no_such"), "unknown_register")]
)
def test_a_refusal_stays_one(ask: Ask, names: tuple[str, ...], code: str) -> None:
    assert [ask(*names).error.code for _ in range(TIMES)] == [code] * TIMES


def test_what_a_name_means_changes_with_the_mode(ask: Ask, board: cm.Board) -> None:
    for _ in range(TIMES):
        assert ask("threshold").error.code == "unknown_register"
        board.mode = "edge_detection"
        replies = [ask("threshold") for _ in range(TIMES)]
        assert [(r.ok, r.registers.mode) for r in replies] == [(True, "edge_detection")] * TIMES
        board.mode = "default"


def test_no_answer_comes_from_a_region_that_is_being_loaded(ask: Ask, board: cm.Board) -> None:
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
