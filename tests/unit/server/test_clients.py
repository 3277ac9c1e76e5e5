# SPDX-License-Identifier: Apache-2.0
"""What each client has under way: bounds in bytes, and turns."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cm.server.rights.principal import Principal, from_id
from cm.server.settings.model import USUAL
from cm.server.shares import LITTLE, PENDING, Clients, RepliesUnread, Ring, TooMuchWaiting
from cm.wire.messages.status import Reply

LIMITS = replace(USUAL, waiting_bytes=1000, replies_bytes=100_000)


class Sent:
    """A reply that is read when a test says so."""

    done = False


@pytest.fixture
def clients() -> Clients:
    return Clients(LIMITS, from_id)


def ignore(_: Reply) -> None:
    pass


def test_owners_take_turns_and_what_each_has_comes_in_order() -> None:
    ring: Ring[str, int] = Ring()
    for number in range(4):
        ring.add("many", number)
    ring.add("one", 9)
    taken = [ring.take() for _ in range(2)]
    ring.put_back("many", 0)
    assert [*taken, *(ring.take() for _ in range(4))] == [
        ("many", 0), ("one", 9), ("many", 0), ("many", 1), ("many", 2), ("many", 3),
    ]  # fmt: skip
    assert not ring


def test_a_client_has_so_many_requests_under_way_and_gets_room_as_they_end(clients: Clients) -> None:
    client = clients.of("ipc:0:0:9000001")
    ends = [client.under_way(ignore, 1) for _ in range(PENDING)]
    with pytest.raises(TooMuchWaiting, match="64 requests of pid 9000001"):
        client.under_way(ignore, 1)
    ends[0](Reply())
    client.under_way(ignore, 1)


def test_it_is_found_out_once_whose_a_connection_is() -> None:
    asked: list[str] = []

    def who(connection: str) -> Principal:
        asked.append(connection)
        return from_id(connection)

    clients = Clients(LIMITS, who)
    assert clients.of("ipc:0:0:9000001") is clients.of("ipc:0:0:9000001")
    assert asked == ["ipc:0:0:9000001"]


def test_waiting_requests_are_bounded_for_one_client_and_for_all(clients: Clients) -> None:
    one, two = clients.of("ipc:0:0:9000001"), clients.of("ipc:0:0:9000002")
    one.under_way(ignore, 900)
    with pytest.raises(TooMuchWaiting, match="900 bytes of pid 9000001"):
        one.under_way(ignore, 200)
    two.under_way(ignore, 500)
    with pytest.raises(TooMuchWaiting, match="1400 of all"):
        two.under_way(ignore, 200)
    clients.of("ipc:0:0:9000003").under_way(ignore, 5000)  # one that has nothing waiting is let in


def test_a_client_that_does_not_read_gets_no_more_until_it_does(clients: Clients) -> None:
    client, reply = clients.of("ipc:0:0:9000001"), Sent()
    client.sent(reply, 100_001, b"a")
    assert not client.reads(b"a")
    assert client.reads(b"b")  # its other connections go on
    with pytest.raises(RepliesUnread, match="100001 bytes of answers to pid 9000001"):
        client.check_room()
    assert [client.reads_nothing] == [False]
    client.sent(Sent(), 100_000, b"a")
    assert [client.reads_nothing] == [True]
    reply.done = True
    client.look_at_replies()
    assert (client.unread_bytes, client.unread_of, client.reads_nothing) == (100_000, {b"a": 100_000}, False)


def test_a_client_with_little_unread_is_served_whatever_others_leave(clients: Clients) -> None:
    client = clients.of("ipc:0:0:9000003")
    client.sent(Sent(), LITTLE - 1, b"c")
    for pid in (9000001, 9000002):
        assert client.has_room(10_000)
        clients.of(f"ipc:0:0:{pid}").sent(Sent(), 90_000, b"%d" % pid)
    assert client.reads(b"c")
    assert not client.has_room(10_000)  # though no long reply as long as others leave so much


def test_clients_that_are_gone_and_have_nothing_are_forgotten(clients: Clients) -> None:
    clients.of("ipc:0:0:9000001").upload_bytes = 1
    for pid in (9000002, 9000003):
        clients.of(f"ipc:0:0:{pid}")
    assert [client.name for client in clients.told({"pid 9000002": 4})] == ["pid 9000001", "pid 9000002"]
    assert [client.connections for client in clients.told({"pid 9000002": 4})] == [0, 4]
    assert {client.account for client in clients.told({})} == {"uid:0"}
