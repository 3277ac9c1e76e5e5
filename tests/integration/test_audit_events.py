# SPDX-License-Identifier: Apache-2.0
"""`cm_audit`: whoever subscribes to it by name learns who asked for what, and how it ended."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator

import pytest
from manager_process import Manager

from cm.client.board import Board
from cm.client.errors import RequestFailed
from cm.wire import topics
from cm.wire.decode import decode_request
from cm.wire.encode import decode_event
from cm.wire.messages import requests as rq
from cm.wire.messages.status import Audit, Status

Told = Callable[[int], list[Audit]]


@pytest.fixture
def told(board: Board) -> Iterator[Told]:
    subscription = board.subscribe(topics.AUDIT, topics.STATUS)

    def events(number: int) -> list[Audit]:
        """So many, as they come."""
        found: list[Audit] = []
        while len(found) < number:
            frames = subscription.receive(60.0)
            assert frames is not None
            event = decode_event(frames)
            if isinstance(event, Audit):
                found.append(event)
        return found

    first = subscription.receive(60.0)
    assert first is not None
    assert isinstance(decode_event(first), Status)  # from here on nothing is missed
    yield events
    subscription.close()


def test_a_write_is_told_with_its_writer_and_its_generation(board: Board, told: Told) -> None:
    before = time.monotonic_ns()
    generation = board.registers.write({"focus": 5}).generation
    (event,) = told(1)
    assert (event.request, event.topic, event.error) == ("WriteReg", "cm_write_reg", None)
    assert decode_request([event.topic.encode(), event.message]) == rq.WriteReg((rq.RegWrite("focus", 5),))
    assert (event.pid, event.account) == (os.getpid(), f"uid:{os.getuid()}")
    assert f"(uid {os.getuid()}, pid {os.getpid()})" in event.client
    assert event.generation == generation
    assert before < event.began_ns <= event.ended_ns < time.monotonic_ns()


def test_a_change_is_told_when_it_begins_and_when_it_has_ended(board: Board, told: Told) -> None:
    board.load("camera", "edge_detection")
    begun, ended = told(2)
    assert (begun.request, begun.ended_ns, begun.change) == ("ChangeMode", 0, 0)
    assert (ended.began_ns, ended.change) == (begun.began_ns, board.status.last_change)
    assert ended.ended_ns > ended.began_ns
    board.load("camera", "default")


def test_a_refusal_is_told_with_its_error(board: Board, told: Told) -> None:
    with pytest.raises(RequestFailed):
        board.load("camera", "nowhere")
    (event,) = told(1)
    assert event.error is not None
    assert event.error.code == "unknown_mode"


def test_ids_of_leases_are_told_to_nobody(board: Board, told: Told) -> None:
    with board.lease("registers:focus") as held:
        name = held.id.encode()
        board.registers["focus"] = 1
    taken, written, released = told(3)
    assert [e.request for e in (taken, written, released)] == ["TakeLease", "WriteReg", "ReleaseLease"]
    assert name
    assert not any(name in event.message for event in (taken, written, released))


def test_reads_are_not_told(board: Board, told: Told) -> None:
    _ = board.registers.read("focus"), board.status, board.config()
    board.registers["focus"] = 2
    assert told(1)[0].request == "WriteReg"


def test_a_subscription_to_everything_does_not_ask_for_it(manager: Manager, board: Board) -> None:
    subscription = board.subscribe(b"")
    assert subscription.receive(60.0) is not None  # the status: the subscription is in effect
    seen = []
    for value in (3, 4):  # what would be told of the first comes before the values of the second
        board.registers["focus"] = value
    while seen.count(topics.READ_REG) < 2:
        frames = subscription.receive(60.0)
        assert frames is not None
        seen.append(bytes(frames[0]))
    assert topics.AUDIT not in seen
    subscription.close()
