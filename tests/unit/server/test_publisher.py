# SPDX-License-Identifier: Apache-2.0
"""What is published to listeners, and not even built without any."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from manager_process import short_folder

from cm._version import __version__
from cm.server.publisher import AT_A_TIME, TOPICS_EACH, Publisher, StatusPublisher, Subscriptions, UnreadFrames
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
    yield Publisher(loop, socket, "a board")
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
    with subscribing(socket, topic) as sub:
        assert publisher.take_subscriptions()
        assert publisher.status(lambda: Status("camera", "default", **publisher.beside()))
        told: Any = decode_event(sub.recv_multipart())
    assert (told.config_name, told.mode, told.sequence, told.board) == ("camera", "default", 2, "a board")
    assert (told.version, 0 <= time.time_ns() - told.started_ns < 10**11) == (__version__, True)
    assert abs(told.realtime_offset_ns - (time.time_ns() - time.monotonic_ns())) < 10**9


def test_a_subscription_to_another_topic_does_not_include_the_status(socket: Any, publisher: Publisher) -> None:
    with subscribing(socket, b"cm_irq") as sub:
        assert not publisher.take_subscriptions()
        assert not publisher.status(never)
        publisher.interrupt(Irq("done", 3, 17))
        assert decode_event(sub.recv_multipart()) == Irq("done", 3, 17)


def test_registers_reach_a_subscriber_that_the_publisher_does_not_know_yet(socket: Any, publisher: Publisher) -> None:
    values = RegValues((RegValue("led", 3),), "camera", "default", 9)
    with subscribing(socket, b"cm_read_reg") as sub:
        publisher.registers(values)
        assert decode_event(sub.recv_multipart()) == values


@pytest.mark.parametrize(
    ("topic", "streams"),
    [
        (b"", "camera other"), (b"cm_stream/", "camera other"), (b"cm_stream/cam", "camera"),
        (b"cm_read_data", "camera other"), (b"cm_data_read", "camera other"),
        (b"cm_status", ""), (b"cm_stream/camera2", ""),
    ],
)  # fmt: skip
def test_a_stream_is_wanted_by_whom_its_frames_would_reach(
    socket: Any, publisher: Publisher, topic: bytes, streams: str
) -> None:
    with subscriber(socket, publisher, topic):
        assert [name for name in ("camera", "other") if publisher.wants_stream(name)] == streams.split()


def test_an_error_is_logged_once_until_another_or_none_follows(
    publisher: Publisher, caplog: pytest.LogCaptureFixture
) -> None:
    busy, failed = ErrorInfo("busy", "one runs"), ErrorInfo("io", "it stopped")
    for error, change in ((busy, 3), (busy, 4), (None, 4), (busy, 0), (failed, 5)):
        publisher.log(error, change)
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [
        ("WARNING", "busy: one runs (change 3)"),
        ("WARNING", "busy: one runs"),
        ("WARNING", "io: it stopped (change 5)"),
    ]


# ---- what may wait, and what may be subscribed to -----------------------------------------------


@pytest.mark.parametrize(("size", "fit"), [(100, 15), (300, 7)], ids=["so many bytes", "so many frames"])
def test_all_subscribers_may_leave_half_as_much_more_than_one_unread(size: int, fit: int) -> None:
    ended: list[int] = []
    kept = UnreadFrames(1000, 2, lambda: ended.append(kept.bytes))
    frames: list[Any] = [SimpleNamespace(done=False) for _ in range(fit + 1)]
    for frame in frames:
        kept.add(frame, size)
    assert ended == [(fit + 1) * size]
    for frame in frames[:-1]:
        frame.done = True
    kept.add(frames[-1], size)
    assert (kept.bytes, len(ended)) == (2 * size, 1)


class Known(Subscriptions):
    """What is subscribed to, and which connections were ended for it."""

    def __init__(self) -> None:
        self.ended: list[tuple[int, str]] = []
        super().__init__(lambda *owner: self.ended.append(owner))


def test_a_connection_that_subscribes_to_too_much_or_too_often_is_ended() -> None:
    known = Known()
    for _ in range(2):  # what was given up counts no longer
        known.add(b"a" * (TOPICS_EACH - 4), 1, "one")
        known.add(b"b", 1, "one")
        known.discard(b"b")
        known.add(b"ab", 1, "one")
        known.discard(b"ab")
        known.discard(b"a" * (TOPICS_EACH - 4))
        assert known.ended == []
    known.add(b"a" * (TOPICS_EACH - 4), 1, "one")
    known.add(b"abc", 1, "one")
    assert known.ended == [(1, "one")]
    for _ in range(2):
        for _ in range(AT_A_TIME):
            known.add(b"b", 2, "two")
        known.settle()
    assert known.ended == [(1, "one")]
    for _ in range(AT_A_TIME + 2):
        known.add(b"b", 2, "two")
    assert known.ended == [(1, "one"), (2, "two")]


def test_a_subscription_covers_the_topics_that_begin_with_it() -> None:
    known = Known()
    assert not known.covers(b"cm_status")
    known.add(b"cm_s", 1, "")
    known.add(b"cm_s", 2, "")
    assert [known.covers(topic) for topic in (b"cm_", b"cm_s", b"cm_status", b"xcm_s")] == [False, True, True, False]
    assert [known.covers(b"cm_status", least) for least in (4, 5)] == [True, False]
    known.discard(b"cm_status")  # was never there
    known.discard(b"cm_s")
    assert not known.covers(b"cm_status")
    known.add(b"", 1, "")
    assert [known.covers(b"cm_status", least) for least in (0, 1)] == [True, False]


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
        self.registers: Any = None
        make: Any = StatusPublisher
        self.told = make(self, self, None)
        self.told.status = lambda moment=None: moment.step if moment else 100
        self.watches: list[Any] = []
        self.logged: list[Any] = []
        self.rested = self.reads = 0
        self.loaded: Any = None
        self.interrupts = SimpleNamespace(incomplete=False, config=None, watch=self.watches.append)
        self.told.begin(self, self.interrupts)
        self.told.at_rest = self._rest
        self.reporter = SimpleNamespace(moment=self._moment, was_read=self._read)

    def call_threadsafe(self, call: Any) -> None:
        self.soon.append(call)

    def call_later(self, _: float, call: Any) -> None:
        self.later.append(call)

    def passes_over(self) -> bool:
        return False

    def status(self, make: Any) -> bool:
        self.published.append(make())
        return True

    def log(self, *said: Any) -> None:
        self.logged.append(said)

    def loaded_config(self) -> Any:
        return self.loaded

    def _rest(self) -> None:
        self.rested += 1

    def _read(self) -> None:
        self.reads += 1

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
    assert it.rested == 0
    it.running = False
    it.told.status_changed()
    it.turn(it.soon)
    assert (it.published[-1], it.rested) == (9, 1)


@pytest.mark.parametrize(
    ("watched", "incomplete", "anew"), [("one", False, 1), ("two", False, 0), ("two", True, 1)],
    ids=["another configuration", "the same", "a line is missing"],
)  # fmt: skip
def test_at_rest_the_interrupts_of_what_is_loaded_are_watched(watched: str, incomplete: bool, anew: int) -> None:
    it = Told()
    it.running, it.loaded, it.interrupts.config, it.interrupts.incomplete = False, "two", watched, incomplete
    it.told.status_changed()
    it.turn(it.soon)
    assert it.watches == ["two"] * anew
    assert it.logged == [(None, 0)]
    assert it.reads == 1


def test_who_asks_for_the_status_is_told_first_of_what_was_before() -> None:
    it = Told()
    for _ in range(2):
        it.told.progressed()
        it.turn(it.soon)
    it.told.publish()
    assert it.published == [1, 2, 100]
