# SPDX-License-Identifier: Apache-2.0
"""Whose turn it is: the account that has spent least, then its client that has, then its connections in turn."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.server.shares.budget import Bounds, TooMuchWaiting
from cm.server.shares.registry import Budgets
from cm.server.shares.turns import Account, Client, Turns, VirtualTime, least

COST = 1000  # nanoseconds of a request


class Named(Client):
    __slots__ = ("name",)

    def __init__(self, name: str, account: Account) -> None:
        super().__init__(account)
        self.name = name


@pytest.fixture
def clock() -> VirtualTime:
    return VirtualTime()


@pytest.fixture
def turns() -> Turns[Named, int]:
    return Turns()


def served(turns: Turns[Named, int], cost: dict[str, int] | None = None, count: int | None = None) -> list[str]:
    """Who is served, for `count` turns or until nobody waits; `cost`: nanoseconds of a request of each."""
    order = []
    while turns and (count is None or len(order) < count):
        client, _ = turns.take()
        client.charge((cost or {}).get(client.name, COST))
        order.append(client.name)
    return order


def test_256_connections_are_one_client(clock: VirtualTime, turns: Turns[Named, int]) -> None:
    hostile, other = Named("hostile", Account("a", clock)), Named("other", Account("b", clock))
    for connection in range(256):
        for number in range(4):
            turns.add(hostile, connection, number)
    assert served(turns, count=10) == ["hostile"] * 10
    turns.add(other, "one", 0)
    assert served(turns, count=1) == ["other"]
    for number in range(8):
        turns.add(other, "one", number)
    assert Counter(served(turns, count=16)) == {"other": 8, "hostile": 8}


def test_many_processes_of_one_account_are_one_account(clock: VirtualTime, turns: Turns[Named, int]) -> None:
    account = Account("uid:1000", clock)
    for process in range(100):
        turns.add(Named(f"hostile {process}", account), 0, 0)
        turns.add(Named(f"hostile {process}", account), 1, 0)
    other = Named("other", Account("uid:1001", clock))
    for number in range(50):
        turns.add(other, 0, number)
    assert served(turns, count=100).count("other") == 50


def test_processes_of_one_account_take_turns_too(clock: VirtualTime, turns: Turns[Named, int]) -> None:
    account = Account("uid:1000", clock)
    hostile, other = Named("hostile", account), Named("other", account)
    for number in range(100):
        turns.add(hostile, number, number)
    for number in range(20):
        turns.add(other, 0, number)
    assert Counter(served(turns, count=40)) == {"hostile": 20, "other": 20}


def test_turns_depend_on_time_spent_and_not_on_the_number_of_requests(
    clock: VirtualTime, turns: Turns[Named, int]
) -> None:
    slow, quick = Named("slow", Account("a", clock)), Named("quick", Account("b", clock))
    for number in range(200):
        turns.add(slow, 0, number)
        turns.add(quick, 0, number)
    assert Counter(served(turns, {"slow": 9 * COST}, 100)) == {"slow": 10, "quick": 90}


def test_an_account_may_have_a_larger_share(clock: VirtualTime, turns: Turns[Named, int]) -> None:
    favoured, other = Named("favoured", Account("a", clock, share=4)), Named("other", Account("b", clock))
    for number in range(200):
        turns.add(favoured, 0, number)
        turns.add(other, 0, number)
    assert Counter(served(turns, count=100)) == {"favoured": 80, "other": 20}


def test_an_absent_client_gains_no_credit_and_time_alone_is_not_charged(
    clock: VirtualTime, turns: Turns[Named, int]
) -> None:
    busy, back = Named("busy", Account("a", clock)), Named("back", Account("b", clock))
    for number in range(1000):
        turns.add(busy, 0, number)
    served(turns, count=500)
    for number in range(500):
        turns.add(back, 0, number)
    assert Counter(served(turns, count=100)) == {"busy": 50, "back": 50}


def test_time_that_is_spent_outside_of_turns_counts(clock: VirtualTime, turns: Turns[Named, int]) -> None:
    """On pieces of long work, while messages wait."""
    worker, other = Named("worker", Account("a", clock)), Named("other", Account("b", clock))
    for number in range(20):
        turns.add(worker, 0, number)
        turns.add(other, 0, number)
    worker.charge(10 * COST)
    assert served(turns, count=10) == ["other"] * 10
    assert least([worker, other]) in (worker, other)
    assert least([]) is None


def test_the_least_of_several_is_by_account_first_and_then_by_client(clock: VirtualTime) -> None:
    rich, poor = Account("rich", clock), Account("poor", clock)
    a, b, c = Named("a", rich), Named("b", rich), Named("c", poor)
    a.charge(5)
    c.charge(6)
    b.charge(4)
    assert least([a, b, c]) is c
    assert least([a, b]) is b


def test_a_client_that_is_alone_is_served_as_if_it_had_waited(clock: VirtualTime, turns: Turns[Named, int]) -> None:
    first, second = Named("first", Account("a", clock)), Named("second", Account("a", clock))
    for client, cost in ((first, 5), (second, 7), (first, 1), (second, 2)):
        client.is_alone()
        client.charge(cost)
        alone = clock.now, client.clock.now, client.spent, client.account.spent
        client.spent -= cost
        client.account.spent -= cost
        client.comes()
        client.goes()
        client.charge(cost)
        assert (clock.now, client.clock.now, client.spent, client.account.spent) == alone


def test_connections_of_a_client_take_turns_and_each_keeps_its_order(
    clock: VirtualTime, turns: Turns[Named, int]
) -> None:
    client = Named("one", Account("a", clock))
    for connection, number in ((0, 1), (0, 2), (0, 3), (1, 10), (2, 20), (1, 11)):
        turns.add(client, connection, number)
    assert [turns.take()[1] for _ in range(6)] == [1, 10, 20, 2, 11, 3]
    assert not turns
    with pytest.raises(IndexError):
        turns.take()


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2), st.integers(0, 3)), max_size=60),
    st.lists(st.integers(0, 10_000), min_size=60, max_size=60),
)
def test_everything_is_served_once_and_in_order_of_its_connection(
    asked: list[tuple[int, int, int]], costs: list[int]
) -> None:
    clock, turns = VirtualTime(), Turns[Named, tuple[str, int, int]]()
    accounts = [Account(str(n), clock) for n in range(3)]
    clients = {(a, c): Named(f"{a}/{c}", accounts[a]) for a in range(3) for c in range(3)}
    added, out = [], []
    for number, (account, client, connection) in enumerate(asked):
        added.append((f"{account}/{client}", connection, number))
        turns.add(clients[account, client], connection, added[-1])
        if number % 3 == 2:
            who, item = turns.take()
            who.charge(costs[number])
            out.append(item)
    while turns:
        who, item = turns.take()
        who.charge(7)
        out.append(item)
    assert sorted(out) == sorted(added)
    for key in {(name, connection) for name, connection, _ in added}:
        assert [i for *k, i in out if tuple(k) == key] == [i for *k, i in added if tuple(k) == key]


class Somebody:
    """As `cm.server.rights` has it."""

    pid, address = None, ""

    def __init__(self, name: str) -> None:
        self.name, self.key, self.account = name, name, f"key:{name}"


class Process(Somebody):
    """One of a user's."""

    def __init__(self, name: str) -> None:
        self.name, self.key, self.pid, self.account = "anna", "", int(name) + 2**22, "uid:1000"


def test_shares_are_those_of_the_settings_by_name_and_renewed() -> None:
    budgets = Budgets(Bounds(1, 1), Somebody, lambda *_: None, tuple, {"anna": 4.0})
    anna, other = budgets.of("anna"), budgets.of("other")
    assert (anna.account.share, other.account.share) == (4.0, 1.0)
    budgets.renew(Bounds(2, 2), {"other": 0.5})
    assert (budgets.of("anna"), budgets.of("other")) == (anna, other)
    assert (anna.account.share, other.account.share) == (1.0, 0.5)
    assert anna.bounds == Bounds(2, 2)


def test_bytes_that_wait_are_bounded_by_client_account_and_all() -> None:
    budgets = Budgets(Bounds(800, 1), Somebody, lambda *_: None, tuple)
    anna, other = budgets.of("anna"), budgets.of("other")
    anna.queue(5000)  # who has nothing gets one through
    with pytest.raises(TooMuchWaiting, match="1 requests of key anna wait, 5000 bytes"):
        anna.queue(1)
    other.queue(1)  # and so does another
    with pytest.raises(TooMuchWaiting):
        other.queue(1)
    anna.unqueue(5000)
    other.queue(700)
    assert (other.waiting, other.queued_bytes, budgets.queued_bytes) == (2, 701, 701)
    for size in (1, 700):
        other.unqueue(size)
    assert (other.waiting, other.queued_bytes, budgets.queued_bytes, other.account.queued_bytes) == (0, 0, 0, 0)


def test_a_short_request_gets_through_whatever_others_of_its_account_have_waiting() -> None:
    """Two processes of a user fill what there is for that user; a third one is served."""
    budgets = Budgets(Bounds(32 << 20, 1), Process, lambda *_: None, tuple)
    for name in ("1", "2"):
        budgets.of(name).queue(18 << 20)
    budgets.of("3").queue(1024)
    with pytest.raises(TooMuchWaiting, match="0 requests of pid 4"):
        budgets.of("4").queue(1 << 20)


class Read:
    """A tracker of what was read, or was not yet."""

    done = False


class Time:
    """That of looks at what was read."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.now = 0
        patch.setattr("cm.server.shares.registry.monotonic_ns", lambda: self.now)


class Preempted(Read):
    """The loop is not run for a second while it looks at this one."""

    def __init__(self, time: Time) -> None:
        self._time = time

    @property
    def done(self) -> bool:  # type: ignore[override]
        self._time.now += 1_000_000_000
        return False


def test_replies_count_until_a_later_one_of_their_connection_was_read() -> None:
    budgets = Budgets(Bounds(1, 100_000), Process, lambda *_: None, tuple)
    budget, read = budgets.of("1"), Read()
    told = [budget.replied(b"a", 1000) for _ in range(13)]
    assert told[:12] == [0] * 12
    assert told[12] > 13_000  # and what ZeroMQ takes for them
    budget.sent(read, told[12], b"a")
    assert (budget.unread_bytes, budget.account.leaving_bytes, budgets.leaving_bytes) == (told[12],) * 3
    assert budget.replied(b"b", 1000) == 0  # another connection
    read.done = True
    assert (budget.unread_bytes, budget.account.leaving_bytes, budgets.leaving_bytes) == (0, 0, 0)


def test_a_client_that_does_not_read_one_connection_is_answered_over_another(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    budgets = Budgets(Bounds(1, 100_000), Process, lambda *_: None, tuple)
    budget, unread = budgets.of("1"), Read()
    budget.sent(unread, 101_000, b"a")
    assert (budget.reads(b"a"), budget.reads(b"b")) == (False, True)
    budget.sent(Read(), 33_000, b"b")
    assert not budget.reads(b"b")  # that has more than a little unread, too
    assert budgets.of("2").has_room()  # and another process
    assert not budgets.of("2").has_room(20_000)  # but no long reply: its account has enough
    unread.done = True
    assert not budget.reads(b"a")  # it was just looked at
    time.now += 500_000_000
    assert budget.reads(b"a")
    assert budget.reads(b"b")


def test_to_be_preempted_while_it_looks_at_what_was_read_costs_the_loop_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time = Time(monkeypatch)
    budgets = Budgets(Bounds(1, 100_000), Process, lambda *_: None, tuple)
    budget, unread = budgets.of("1"), Read()
    budget.sent(unread, 101_000, b"a")
    budgets.of("2").sent(Preempted(time), 1000, b"b")
    assert not budget.reads(b"a")
    unread.done = True
    time.now += 500_000_000  # less than ten times what the clock went on meanwhile
    assert budget.reads(b"a")


def test_connections_that_may_have_no_turn_are_stopped_and_go_on_in_order(turns: Turns[Client, str]) -> None:
    client = Client(Account("anna", VirtualTime()))
    for connection, item in (("a", "a1"), ("b", "b1"), ("a", "a2")):
        turns.add(client, connection, item)
    allowed = {"b"}

    def may(_: Client, connection: object) -> bool:
        return connection in allowed

    assert turns.take(may) == (client, "b1")
    assert turns.add(client, "a", "a3") is False  # behind what is stopped
    with pytest.raises(IndexError):
        turns.take(may)
    assert (len(turns), turns.anyone, turns.go_on(may)) == (3, False, False)
    allowed.add("a")
    assert turns.go_on(may)
    assert [turns.take(may)[1] for _ in range(3)] == ["a1", "a2", "a3"]
    assert not turns.stopped


def test_the_rest_of_something_comes_before_all_else_of_its_connection(clock: VirtualTime) -> None:
    turns: Turns[Named, str] = Turns()
    one = Named("one", Account("a", clock))
    for item in ("long", "after it"):
        turns.add(one, "first", item)
    turns.add(one, "second", "beside it")
    assert turns.take() == (one, "long")
    turns.again(one, "first", "its rest")
    assert [turns.take()[1] for _ in range(3)] == ["beside it", "its rest", "after it"]
    turns.again(one, "first", "of what was taken last")
    assert turns.take() == (one, "of what was taken last")
    assert not turns


def test_the_rest_of_something_waits_in_its_place_where_its_connection_may_not_go_on(clock: VirtualTime) -> None:
    turns: Turns[Named, str] = Turns()
    one = Named("one", Account("a", clock))
    for item in ("long", "after it"):
        turns.add(one, "first", item)
    turns.take()
    with pytest.raises(IndexError):
        turns.take(lambda _, __: False)
    turns.again(one, "first", "its rest")
    assert turns.go_on(lambda _, __: True)
    assert [turns.take()[1] for _ in range(2)] == ["its rest", "after it"]
