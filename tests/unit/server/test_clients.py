# SPDX-License-Identifier: Apache-2.0
"""What each client has under way: bounds in bytes, and turns."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cm.errors import Busy
from cm.server.client_quotas import LITTLE, PENDING, Clients, RepliesUnread, Ring, TooMuchWaiting
from cm.server.long_work import NOT_YET, FileThread, RoundRobin
from cm.server.rights.principal import Principal, from_id
from cm.server.settings.model import USUAL
from cm.wire.messages.status import ClientStatus

LIMITS = replace(USUAL, waiting_bytes=1000, replies_bytes=100_000)


class Sent:
    """A reply that is read when a test says so."""

    done = False


@pytest.fixture
def clients() -> Clients:
    return Clients(LIMITS, from_id)


def test_users_take_turns_and_so_do_the_clients_of_each_and_what_one_has_comes_in_order() -> None:
    ring: Ring[int] = Ring()
    for number in range(3):
        ring.add(("many", "a"), number)
    ring.add(("many", "b"), 7)
    ring.add(("one", "c"), 9)
    assert (len(ring), ring.count("many"), ring.count("nobody")) == (3, 4, 0)
    taken = [ring.take() for _ in range(2)]
    ring.put_back(("many", "a"), 0)
    assert [*taken, *(ring.take() for _ in range(4))] == [
        (("many", "a"), 0), (("one", "c"), 9), (("many", "b"), 7), (("many", "a"), 0), (("many", "a"), 1),
        (("many", "a"), 2),
    ]  # fmt: skip
    assert not ring


def test_a_client_has_so_many_requests_under_way_and_gets_room_as_they_end(clients: Clients) -> None:
    client = clients.of("ipc:0:0:9000001")
    for _ in range(PENDING):
        client.begin(1)
    for process in (client, clients.of("ipc:0:0:9000002")):  # of the same user
        with pytest.raises(TooMuchWaiting, match="64 requests of uid:0"):
            process.begin(1)
    clients.of("ipc:7:0:9000003").begin(1)
    client.ended(1)
    client.begin(1)


def test_it_is_found_out_once_whose_a_connection_is() -> None:
    asked: list[str] = []

    def who(connection: str) -> Principal:
        asked.append(connection)
        return from_id(connection)

    clients = Clients(LIMITS, who)
    assert clients.of("ipc:0:0:9000001") is clients.of("ipc:0:0:9000001")
    assert asked == ["ipc:0:0:9000001"]


def test_waiting_requests_are_bounded_for_one_client_and_for_all(clients: Clients) -> None:
    one, two = clients.of("ipc:0:0:9000001"), clients.of("ipc:7:0:9000002")
    one.begin(900)
    for process in (one, clients.of("ipc:0:0:9000004")):  # of the same user
        with pytest.raises(TooMuchWaiting, match="900 bytes of uid:0"):
            process.begin(200)
    two.begin(500)
    with pytest.raises(TooMuchWaiting, match="1400 of all"):
        two.begin(200)
    clients.of("ipc:8:0:9000003").begin(5000)  # one that has nothing waiting is let in


def test_a_client_that_does_not_read_gets_no_more_until_it_does(clients: Clients) -> None:
    client, reply = clients.of("ipc:0:0:9000001"), Sent()
    client.sent(reply, 100_001, b"a")
    assert not client.reads(b"a")
    assert client.reads(b"b")  # its other connections go on
    with pytest.raises(RepliesUnread, match="100001 bytes of answers to uid:0"):
        client.check_room()
    assert [client.reads_nothing] == [False]
    client.sent(Sent(), 100_000, b"a")
    other = clients.of("ipc:0:0:9000002")  # of the same user
    assert [client.reads_nothing, other.reads_nothing, other.has_room(LITTLE), other.has_room(LITTLE + 1)] == [
        True, False, True, False,
    ]  # fmt: skip
    reply.done = True
    client.count_unread()
    assert (client.unread_bytes, client.unread_of, client.reads_nothing) == (100_000, {b"a": 100_000}, False)


def test_a_client_with_little_unread_is_served_whatever_others_leave(clients: Clients) -> None:
    client = clients.of("ipc:0:0:9000003")
    client.sent(Sent(), LITTLE - 1, b"c")
    for pid in (9000001, 9000002):
        assert client.has_room(10_000)
        clients.of(f"ipc:{pid}:0:{pid}").sent(Sent(), 90_000, b"%d" % pid)
    assert client.reads(b"c")
    assert not client.has_room(10_000)  # though no long reply as long as others leave so much


def test_clients_that_are_gone_and_have_nothing_are_forgotten(clients: Clients) -> None:
    clients.of("ipc:0:0:9000001").upload_bytes = 1
    for pid in (9000002, 9000003):
        clients.of(f"ipc:0:0:{pid}")
    assert [client.name for client in clients.statuses({"pid 9000002": 4})] == ["pid 9000001", "pid 9000002"]
    assert [client.connections for client in clients.statuses({"pid 9000002": 4})] == [0, 4]
    assert {client.account for client in clients.statuses({})} == {"uid:0"}


def test_all_bounds_are_of_what_there_may_be_at_most(clients: Clients) -> None:
    one, two = clients.of("ipc:0:0:9000001"), clients.of("ipc:7:0:9000002")
    one.begin(400)
    one.queue(600)
    assert (one.waiting_bytes, one.pending) == (1000, 1)
    two.queue(500)
    two.waiting_bytes -= 500
    one.ended(400)
    assert (one.waiting_bytes, one.pending) == (600, 0)
    one.sent(Sent(), 100_000 - 10, b"a")
    assert [one.has_room(size) for size in (10, 11)] == [True, False]
    two.make(50_000 - 5)  # all may have half as much more as one
    assert [one.has_room(size) for size in (10, 15, 16)] == [True, False, False]
    assert [two.has_room(size) for size in (15, 16)] == [True, False]
    clients.limits = replace(LIMITS, replies_bytes=200_000)
    assert one.has_room(16)


@pytest.mark.parametrize(
    ("who", "name", "account"),
    [
        (Principal("a", "curve", "laptop", key="k" * 40, address="10.0.0.1"), "key laptop", "key:laptop"),
        (Principal("a", "curve", key="k" * 40, address="10.0.0.1"), f"key {'k' * 40}", f"key:{'k' * 40}"),
        (Principal("a", "tcp", address="10.0.0.1"), "10.0.0.1", "tcp:10.0.0.1"),
        (Principal("", ""), "somebody", ":"), (from_id("ipc:5:6:9000001"), "pid 9000001", "uid:5"),
        (from_id(f"ipc:5:6:{os.getpid()}"), f"pid {os.getpid()} (COMM)", "uid:5"),
    ],
    ids=lambda given: "",
)  # fmt: skip
def test_a_client_is_known_by_its_process_its_key_or_its_address(who: Principal, name: str, account: str) -> None:
    clients = Clients(LIMITS, lambda _: who)
    one = clients.of("a")
    assert one is clients.of("b")
    comm = Path(f"/proc/{os.getpid()}/comm").read_text().strip()  # pytest-xdist gives its processes other ones
    assert (one.name, one.account) == (name.replace("COMM", comm), account)
    assert list(clients) == [one]


def test_what_a_client_has_is_told(clients: Clients) -> None:
    client = clients.of("tcp:::ffff:10.0.0.1")
    client.requests, client.refused, client.upload_bytes = 5, 2, 7
    client.begin(100)
    client.make(10)
    client.sent(Sent(), 20, b"a")
    clients.of("ipc:0:0:9000001").upload_bytes = 1
    (told, _) = clients.statuses({"10.0.0.1": 3})
    assert told == ClientStatus(
        "::ffff:10.0.0.1", connections=3, upload_bytes=7, waiting_bytes=130, unread_bytes=30, requests=5, refused=2,
        account="tcp:::ffff:10.0.0.1", waiting=1,
    )  # fmt: skip
    totals = clients.upload_bytes(), clients.waiting_bytes(), clients.unread_bytes()
    assert totals == (8, 100, 30)


@pytest.mark.parametrize(("count", "left"), [(255, 256), (256, 1)])
def test_of_clients_that_have_nothing_so_many_are_remembered(clients: Clients, count: int, left: int) -> None:
    clients.of("ipc:0:0:9000000").upload_bytes = 1
    for number in range(count):
        clients.of(f"ipc:0:0:{9000001 + number}")
    for sender in range(1024):
        clients.untold[b"%d" % sender] = 1
    clients.settle()
    assert (len(list(clients)), len(clients.known), len(clients.untold)) == (left, left, 1024)
    clients.untold[b"one more"] = 1
    clients.settle()
    assert clients.untold == {}


# ---- work that takes long --------------------------------------------------------------------------


class Turns:
    """A loop whose turns a test takes."""

    def __init__(self) -> None:
        self.soon: list[Callable[[], object]] = []
        self.later: list[Callable[[], object]] = []
        self.call_soon = self.call_threadsafe = self.soon.append

    def call_later(self, seconds: float, call: Callable[[], object]) -> None:
        assert 0 < seconds < 0.1
        self.later.append(call)

    def turn(self) -> bool:
        calls = self.soon[:]
        self.soon.clear()
        for call in calls:
            call()
        return bool(calls)


def job(
    name: str, pieces: int, did: list[str], error: str = "", may_begin: Callable[[], bool] = lambda: True
) -> Iterator[object]:
    """Done in so many pieces, each of which is noted; it may end in an error of its own."""
    while not may_begin():
        yield NOT_YET
    for _ in range(pieces - 1):
        did.append(name)
        yield None
    did.extend((name, f"{name} {error or 'done'}"))


def test_whose_turn_it_is_has_a_piece_done_and_of_one_client_one_job_after_the_other(clients: Clients) -> None:
    loop, did = Turns(), list[str]()
    steps = RoundRobin(loop)  # type: ignore[arg-type]
    one, two = clients.of("ipc:0:0:9000001"), clients.of("ipc:0:0:9000002")
    for client, made in ((one, job("a", 3, did)), (one, job("b", 1, did, "no")), (two, job("c", 2, did))):
        steps.start(client, made)
    steps.run(iter([did.append("own")]))  # type: ignore[func-returns-value]
    assert (did, steps.count("uid:0")) == (["a", "own"], 3)
    while loop.turn():
        pass
    assert did[2:] == ["a", "c", "a", "a done", "c", "c done", "b", "b no"]
    assert (steps.count("uid:0"), loop.later) == (0, [])


def test_so_many_jobs_of_a_user_wait_and_none_after_the_end(clients: Clients) -> None:
    loop, did = Turns(), list[str]()
    steps = RoundRobin(loop)  # type: ignore[arg-type]
    one, two = clients.of("ipc:0:0:9000001"), clients.of("ipc:7:0:9000002")
    for _ in range(PENDING):
        steps.start(one, job("a", 99, did))
    one = clients.of("ipc:0:0:9000003")
    with pytest.raises(Busy, match=f"{PENDING} transfers and long requests of uid:0 wait already; try again"):
        steps.start(one, job("a", 99, did))
    steps.start(two, job("a", 99, did))
    steps.close()
    while loop.turn():
        pass
    assert did == ["a"]


def test_what_cannot_begin_yet_is_asked_again_after_a_while_and_holds_up_nobody(clients: Clients) -> None:
    loop, did, may = Turns(), list[str](), False
    steps = RoundRobin(loop)  # type: ignore[arg-type]
    for number, name in enumerate("ab"):
        steps.start(clients.of(f"ipc:0:0:{9000001 + number}"), job(name, 2, did, may_begin=lambda: may))
    while loop.turn():
        pass
    assert (did, bool(loop.later)) == ([], True)
    steps.start(clients.of("ipc:0:0:9000003"), job("c", 2, did))
    while loop.turn():
        pass
    assert did == ["c", "c", "c done"]
    may = True
    loop.later[-1]()
    while loop.turn():
        pass
    assert did[3:] == ["a", "b", "a", "a done", "b", "b done"]


def test_jobs_beside_the_loop_are_done_one_at_a_time_and_clients_take_turns(clients: Clients) -> None:
    loop, did = Turns(), list[Any]()
    jobs = FileThread(loop)  # type: ignore[arg-type]
    one, two = clients.of("ipc:0:0:9000001"), clients.of("ipc:0:0:9000002")

    def failing() -> None:
        raise ValueError("no")

    def then(result: Callable[[], Any]) -> None:
        try:
            did.append(result())
        except ValueError as error:
            did.append(str(error))

    for client, work in ((one, lambda: 1), (one, failing), (one, lambda: 3), (two, lambda: 4)):
        jobs.submit(client, work, then)
    seen: list[list[Any]] = []
    while len(did) < 4:
        jobs.thread.submit(int).result()  # what runs has ended
        loop.turn()
        seen.append(did[:])
    assert seen == [[1], [1, "no"], [1, "no", 4], [1, "no", 4, 3]]
    for _ in range(PENDING + 1):  # one of them runs
        jobs.submit(one, int, then)
    with pytest.raises(Busy, match=f"{PENDING} requests of uid:0 for what takes long wait already; await a reply"):
        jobs.submit(one, int, then)
    jobs.submit(clients.of("ipc:7:0:9000003"), int, then)
    jobs.close()
    loop.turn()
    assert did[4:] == [0]
