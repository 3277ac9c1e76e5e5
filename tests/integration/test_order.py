# SPDX-License-Identifier: Apache-2.0
"""Requests of one sender take effect in their order, even while the board is slow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import zmq
from manager_process import CAMERA, Manager, patient, served, stalled, until

import cm
from cm.simulation.software import Board as SimBoard
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ErrorInfo, Reply

TO_EDGE = rq.ChangeMode("camera", "edge_detection", no_wait=True, force=True)


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


def test_a_write_to_a_register_of_the_coming_mode_succeeds(board: cm.Board, sender: Sender) -> None:
    sender.send(TO_EDGE, write("threshold", 9))
    assert [error(reply) for reply in sender.replies(2)] == [None, None]
    assert board.registers["threshold"] == 9


def test_a_write_waits_only_for_a_change_that_touches_its_register(
    board: cm.Board, sender: Sender, slow: tuple[Manager, SimBoard]
) -> None:
    with stalled(slow[1]):
        sender.send(rq.ChangeMode("camera", "edge_detection", force=True), write("scratch", 5))
        assert [error(reply) for reply in sender.replies(1)] == [None]
        assert sender.arrived == [1]  # the write was answered before the change had ended
    assert [error(reply) for reply in sender.replies(1)] == [None]


def test_no_sender_waits_for_another_senders_change(
    board: cm.Board, sender: Sender, context: zmq.Context[Any], slow: tuple[Manager, SimBoard]
) -> None:
    other = Sender(context, slow[0])
    other.send(rq.ReadStatus())
    other.replies(1)
    with stalled(slow[1]):
        sender.send(TO_EDGE)
        until(lambda: (p := board.status.progress) is not None and p.step == "load")
        other.send(write("focus", 8))
        [refused] = other.replies(1)
        assert refused.error is not None
        assert refused.error.code == "region_busy"
    until(lambda: not board.status.fpga_busy)


def test_reads_never_wait_and_a_cancel_overtakes(
    board: cm.Board, sender: Sender, slow: tuple[Manager, SimBoard]
) -> None:
    with stalled(slow[1]):
        sender.send(TO_EDGE, write("focus", 6), rq.ReadStatus(), rq.CancelChange())
        sender.replies(3)
        assert sender.arrived == [0, 2, 3]
    sender.replies(1)
    assert sender.arrived == [1]  # the write last: it waited for the change
    until(lambda: not board.status.fpga_busy)
    assert board.registers["focus"] == 6
    assert board.mode in ("default", "edge_detection")


def test_a_configuration_is_there_for_the_change_behind_it(
    board: cm.Board, sender: Sender, slow: tuple[Manager, SimBoard]
) -> None:
    folder = slow[1].root / "lib/firmware/cm/camera"
    files = tuple(rq.File(path.name, path.read_bytes()) for path in sorted(folder.iterdir()))
    text = (CAMERA / "camera.yaml").read_text().replace("name: camera", "name: second", 1)
    sender.send(rq.Provision(text, files), rq.ChangeMode("second", "default"), write("focus", 3))
    assert [error(reply) for reply in sender.replies(3)] == [None, None, None]
    assert (board.status.config_name, board.registers["focus"]) == ("second", 3)


def test_a_memory_is_written_before_the_register_behind_it(board: cm.Board, sender: Sender) -> None:
    info = board.memories["scratchpad"].info
    values = np.arange(info.size, dtype=np.uint8)
    data = memoryview(values.tobytes())
    sender.send(rq.WriteData("scratchpad", data), write("scratch", 1), rq.ReadData("scratchpad"))
    written, register, read = sender.replies(3)
    assert [error(reply) for reply in (written, register, read)] == [None] * 3
    assert bytes(read.payload[0]) == values.tobytes()


def test_an_unknown_name_is_refused_even_during_a_change(board: cm.Board, sender: Sender) -> None:
    sender.send(TO_EDGE, rq.WriteData("nothing", memoryview(b"1234")), write("nothing", 1))
    codes = [reply.error.code if reply.error else "" for reply in sender.replies(3)]
    assert codes == ["", "unknown_stream", "unknown_register"]
