# SPDX-License-Identifier: Apache-2.0
"""Requests of one sender take effect in their order, even while the board is slow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import zmq
from manager_process import Manager, patient, served, until

import cm
from cm.simulation.software import Board as SimBoard
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ErrorInfo, Reply


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Manager, SimBoard]]:
    """A port that takes a tenth of a second for a module, or as long as the test wants."""
    with served(board=("--icap-rate", "2800000"), schemas=patient(tmp_path_factory.mktemp("camera"))) as both:
        yield both


@pytest.fixture
def board(slow: tuple[Manager, SimBoard]) -> Iterator[cm.Board]:
    with slow[0].connected() as board:
        board.load("camera", "default", force=True)
        yield board


class Sender:
    """A DEALER that does not wait for its answers."""

    def __init__(self, context: zmq.Context[Any], manager: Manager) -> None:
        self.socket = context.socket(zmq.DEALER)
        self.socket.linger = 0
        self.socket.connect(f"ipc://{manager.runtime}/req")
        self._sent = 0
        self.arrived: list[int] = []  # the numbers of the requests, as their last replies came

    def send(self, *requests: rq.Request) -> None:
        for request in requests:
            self.socket.send_multipart([b"%d" % self._sent, b"", *encode_request(request)])
            self._sent += 1

    def replies(self, count: int) -> list[Reply]:
        """The replies by the number of their request."""
        found = {}
        for _ in range(count):
            assert self.socket.poll(60_000)
            number, _, *frames = self.socket.recv_multipart()
            found[int(number)] = decode_reply(frames)
        self.arrived = list(found)
        return [found[number] for number in sorted(found)]


@pytest.fixture
def sender(context: zmq.Context[Any], slow: tuple[Manager, SimBoard]) -> Sender:
    return Sender(context, slow[0])


def write(name: str, value: int) -> rq.WriteReg:
    return rq.WriteReg((rq.RegWrite(name, value),))


def error(reply: Reply) -> ErrorInfo | None:
    return reply.error


@pytest.mark.parametrize("wait", [False, True], ids=["accepted", "ended"])
def test_a_write_behind_a_change_is_not_overwritten_by_it(board: cm.Board, sender: Sender, wait: bool) -> None:
    change = rq.ChangeMode("camera", "edge_detection", no_wait=not wait, force=True)
    for value in (3, 4, 5):
        sender.send(change, write("focus", value), rq.ReadReg(("focus",)))
    replies = sender.replies(9)
    assert [error(reply) for reply in replies] == [None] * 9
    assert [reply.body.values[0].value for reply in replies[2::3]] == [3, 4, 5]  # type: ignore[union-attr]
    until(lambda: not board.status.fpga_busy)
    assert board.registers["focus"] == 5


def test_what_is_published_is_one_sequence_as_the_paper_writes_it(
    board: cm.Board, slow: tuple[Manager, SimBoard], context: zmq.Context[Any]
) -> None:
    publisher = context.socket(zmq.PUB)
    publisher.connect(f"ipc://{slow[0].runtime}/sub")
    until(lambda: published(publisher, board))
    for value in range(1, 6):
        number = board.status.last_change
        publisher.send_multipart([b"cm_config", b"edge"])
        publisher.send_multipart([b"cm_write_reg", b"{ 'focus':%d}" % value])
        publisher.send_multipart([b"cm_config", b"default"])
        publisher.send_multipart([b"cm_write_reg", b"{ 'zoom':2, 'focus':%d}" % (value + 1)])
        until(lambda before=number: board.status.last_change == before + 2 and not board.status.fpga_busy)  # type: ignore[misc]
        until(lambda wanted=value + 1: board.registers["focus"] == wanted)  # type: ignore[misc]
        assert board.status.last_error is None


def published(publisher: Any, board: cm.Board) -> bool:
    """Whether publications arrive yet: subscriptions take time."""
    publisher.send_multipart([b"cm_write_reg", b"{ 'scratch':77}"])
    return board.registers["scratch"] == 77
