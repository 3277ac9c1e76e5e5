# SPDX-License-Identifier: Apache-2.0
"""What is published to listeners, and not even built without any."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from manager_process import short_folder

from cm.server.publisher import Publisher, StatusTold
from cm.server.sockets import Loop
from cm.wire.encode import decode_event
from cm.wire.messages.status import ErrorInfo, Irq, RegValue, RegValues, SensorStatus, Status, StreamStatus

HUNG = 60_000  # milliseconds


@pytest.fixture
def socket() -> Iterator[Any]:
    with short_folder() as folder, zmq.Context() as context, context.socket(zmq.XPUB) as made:
        made.bind(f"ipc://{folder}/pub")
        yield made


@pytest.fixture
def publisher(socket: Any) -> Iterator[Publisher]:
    loop = Loop()
    made = Publisher(loop, socket, "a board")
    yield made
    made.close()
    loop.close()


def subscribing(socket: Any, topic: bytes) -> Any:
    """A client whose subscription has arrived at the socket, although the publisher may not have read it yet."""
    made = socket.context.socket(zmq.SUB)
    made.rcvtimeo, made.linger = HUNG, 0
    made.connect(socket.last_endpoint.decode())
    made.subscribe(topic)
    assert socket.poll(HUNG)
    return made


def subscriber(socket: Any, publisher: Publisher, topic: bytes) -> Any:
    """A client whose subscription the publisher knows."""
    made = subscribing(socket, topic)
    publisher.take_subscriptions()
    return made


def never() -> Status:
    raise AssertionError("a status was made that no one reads")


def test_a_status_without_subscriber_counts_but_is_not_made(publisher: Publisher) -> None:
    assert not publisher.status(never)
    assert not publisher.status(never)
    assert publisher.sequence == 2


@pytest.mark.parametrize("topic", [b"", b"cm_st", b"cm_status"])
def test_a_subscriber_to_a_prefix_of_the_status_gets_it(socket: Any, publisher: Publisher, topic: bytes) -> None:
    publisher.status(never)
    with subscriber(socket, publisher, topic) as sub:
        assert publisher.status(lambda: Status("camera", "default", **publisher.beside()))
        told: Any = decode_event(sub.recv_multipart())
    assert (told.config_name, told.mode, told.sequence, told.board) == ("camera", "default", 2, "a board")


def test_a_subscription_to_another_topic_does_not_include_the_status(socket: Any, publisher: Publisher) -> None:
    with subscriber(socket, publisher, b"cm_irq") as sub:
        assert not publisher.status(never)
        publisher.interrupt(Irq("done", 3, 17))
        assert decode_event(sub.recv_multipart()) == Irq("done", 3, 17)


def test_registers_reach_a_subscriber_that_the_publisher_does_not_know_yet(socket: Any, publisher: Publisher) -> None:
    values = RegValues((RegValue("led", 3),), "camera", "default", 9)
    with subscribing(socket, b"cm_read_reg") as sub:
        publisher.registers(values)
        assert decode_event(sub.recv_multipart()) == values


def test_a_client_that_has_gone_is_no_longer_a_subscriber(socket: Any, publisher: Publisher) -> None:
    with subscriber(socket, publisher, b"cm_status"):
        assert publisher.has_subscriber(b"cm_status")
    assert socket.poll(HUNG)
    publisher.take_subscriptions()
    assert not publisher.status(never)


def test_statuses_that_have_streams_and_sensors_in_common_differ_where_they_differ(
    socket: Any, publisher: Publisher
) -> None:
    stream, sensor = (
        StreamStatus("camera", "dma0", "s2mm", (480, 640)),
        SensorStatus("xadc", "temp0", "temperature", 40),
    )
    failed = StreamStatus("camera", "dma0", "s2mm", (480, 640), frames=7, last_error=ErrorInfo("io", "it stopped"))
    with subscriber(socket, publisher, b"cm_status") as sub:
        publisher.measured((sensor,))
        told: list[Any] = []
        for mode, now in (("one", stream), ("two", stream), ("two", failed), ("one", stream)):
            publisher.status(lambda mode=mode, now=now: Status("c", mode, streams=(now,), **publisher.beside()))  # type: ignore[misc]
            told.append(decode_event(sub.recv_multipart()))
    assert [(x.mode, x.streams, x.sensors) for x in told] == [
        ("one", (stream,), (sensor,)),
        ("two", (stream,), (sensor,)),
        ("two", (failed,), (sensor,)),
        ("one", (stream,), (sensor,)),
    ]
    assert [x.sequence for x in told] == [1, 2, 3, 4]


class Told:
    """What is told of a manager whose change is at steps that are numbers; the loop turns when it is said."""

    def __init__(self) -> None:
        self.soon: list[Any] = []
        self.later: list[Any] = []
        self.published: list[int] = []
        self.step, self.running = 0, True
        make: Any = StatusTold
        self.told = make(self, self, None)
        self.told.status = lambda moment=None: moment.step if moment else 100
        self.told.begin(self, SimpleNamespace(incomplete=False, config=None))
        self.reporter = SimpleNamespace(moment=self._moment, was_read=lambda: None)

    def call_threadsafe(self, call: Any) -> None:
        self.soon.append(call)

    def call_later(self, _: float, call: Any) -> None:
        self.later.append(call)

    def passes_over(self) -> bool:
        return False

    def status(self, make: Any) -> None:
        self.published.append(make())

    def log(self, *_: Any) -> None: ...

    def loaded_config(self) -> None: ...

    def _moment(self) -> Any:
        self.step += 1
        return SimpleNamespace(running=self.running, error=None, last=(0, 0.0), step=self.step)

    def turn(self, calls: list[Any]) -> None:
        while calls:
            calls.pop(0)()


def test_steps_that_follow_closely_are_published_together_and_the_end_of_a_change_at_once() -> None:
    it = Told()
    for _ in range(3):
        it.told.progressed()
    it.turn(it.soon)
    for _ in range(2):
        it.told.progressed()
    assert (it.published, it.soon) == ([1, 2, 3], [])  # the loop is woken once, and then waits a while
    it.turn(it.later)
    assert it.published == [1, 2, 3, 4, 5]
    for _ in range(2):
        it.told.progressed()
        it.turn(it.soon)
    assert it.published == [1, 2, 3, 4, 5, 6]
    it.told.status_changed()
    it.turn(it.soon)
    assert it.published == [1, 2, 3, 4, 5, 6, 7, 8]


def test_who_asks_for_the_status_is_told_first_of_what_was_before() -> None:
    it = Told()
    for _ in range(2):
        it.told.progressed()
        it.turn(it.soon)
    it.told.publish()
    assert it.published == [1, 2, 100]
