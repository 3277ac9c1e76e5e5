# SPDX-License-Identifier: Apache-2.0
"""The node's endpoints over zenoh: what is kept for late subscribers, and what closing waits for."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("xxhash")

from manager_process import until
from ros_peer import unanswered
from zenoh_support import PATIENCE, Peer, Router

from cm.networks.bridge.records import FrameRecord
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.key_expressions import Attachment
from cm.networks.rmw_zenoh.threads import Inbox
from cm.networks.ros.messages import image_head
from cm.networks.ros.transport import EVENTS, LATCHED, Qos

STRING, PLAN = "std_msgs/msg/String", "cm_interfaces/srv/Plan"


@pytest.fixture(scope="module")
def router() -> Iterator[Router]:
    made = Router()
    yield made
    made.close()


@pytest.fixture
def peers(router: Router) -> Iterator[tuple[Peer, Peer]]:
    both = Peer(router.where), Peer(router.where)
    yield both
    for peer in both:
        peer.close()


def test_a_late_subscriber_gets_the_latched_message_and_all_get_the_next(peers: tuple[Peer, Peer]) -> None:
    publisher = peers[0].transport.publisher("/late", STRING, LATCHED)
    for word in ("one", "two"):
        publisher.write({"data": word})
    with peers[1].listening("/late", STRING, LATCHED) as found:
        assert found.get(timeout=PATIENCE)["data"] == "two"
        publisher.write({"data": "three"})
        assert found.get(timeout=PATIENCE)["data"] == "three"
    assert found.empty()


def test_listeners_come_and_go_and_so_do_ends(peers: tuple[Peer, Peer]) -> None:
    publisher = peers[0].transport.publisher("/chatter", STRING, EVENTS)
    assert publisher.listeners() == 0
    with peers[1].listening("/chatter", STRING, EVENTS) as found:
        until(lambda: publisher.listeners() == 1, PATIENCE)
        publisher.write({"data": "hello"})
        assert found.get(timeout=PATIENCE)["data"] == "hello"
    until(lambda: publisher.listeners() == 0, PATIENCE)
    publisher.close()
    publisher.close()
    publisher.write({"data": "nobody"})
    assert publisher.listeners() == 0


def test_each_message_says_who_sent_it_and_counts(peers: tuple[Peer, Peer]) -> None:
    publisher = peers[0].transport.publisher("/counted", STRING, EVENTS)
    found: queue.Queue[Any] = queue.Queue()
    subscriber = peers[1].session.declare_subscriber("7/counted/**", lambda sample: found.put(sample.attachment))
    until(lambda: publisher.listeners() == 1, PATIENCE)
    for _ in range(2):
        publisher.write({"data": "x"})
    first, second = (Attachment.from_bytes(found.get(timeout=PATIENCE).to_bytes()) for _ in range(2))
    assert (first.number, second.number, first.gid) == (1, 2, second.gid)
    assert first.gid == publisher._end.gid
    subscriber.undeclare()


def test_a_frame_with_gaps_between_its_rows_is_sent_without_them(peers: tuple[Peer, Peer]) -> None:
    import numpy as np

    whole = np.arange(61 * 97, dtype=np.uint32).astype(np.uint8).reshape(61, 97)
    data = whole[:, :50]
    record = FrameRecord("eye", 5, 1, "eye", "mono8", 61, 50, 50, data)
    publisher = peers[0].transport.publisher("/eye", "sensor_msgs/msg/Image", Qos(2))
    taken: queue.Queue[Any] = queue.Queue()

    def take(values: dict[str, Any], body: Any) -> None:
        target = np.zeros(body.length, np.uint8)
        body.into(target)
        taken.put((values["encoding"], target.tobytes()))

    subscription = peers[1].transport.frames("/eye", "sensor_msgs/msg/Image", Qos(2), take)
    until(lambda: publisher.listeners() == 1, PATIENCE)
    publisher.write_frame(image_head(record), record)
    assert taken.get(timeout=PATIENCE) == ("mono8", data.tobytes())
    subscription.close()


def test_closing_does_not_wait_for_answers_that_never_come(router: Router) -> None:
    """More of them than are worked on at a time."""
    server, client = Peer(router.where), Peer(router.where)
    with unanswered(server.transport, "/plan", PLAN) as asked:
        key = server.transport._queryables[0].key_expr
        attachment = Attachment(1, 2, bytes(16)).to_bytes()
        until(lambda: client.session.declare_querier(key).matching_status.matching, PATIENCE)
        for _ in range(40):
            client.session.get(key, lambda _: None, payload=cdr.encode(f"{PLAN}_Request", {}), attachment=attachment)
        for _ in range(32):
            assert asked.acquire(timeout=PATIENCE)
        server.close()
    client.close()


def test_an_inbox_keeps_the_newest_of_what_is_not_taken() -> None:
    taken: queue.Queue[int] = queue.Queue()
    held = threading.Event()

    def take(number: int) -> None:
        taken.put(number)
        held.wait(PATIENCE)

    inbox = Inbox("test", 2, take)
    inbox.put(1)
    assert taken.get(timeout=PATIENCE) == 1
    for number in (2, 3, 4):
        inbox.put(number)
    held.set()
    assert [taken.get(timeout=PATIENCE) for _ in range(2)] == [3, 4]
    inbox.close()
    inbox.close()
