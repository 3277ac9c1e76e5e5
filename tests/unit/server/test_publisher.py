# SPDX-License-Identifier: Apache-2.0
"""What is published to listeners, and not even built without any."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import zmq
from manager_process import short_folder

from cm.server.publisher import Publisher
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
