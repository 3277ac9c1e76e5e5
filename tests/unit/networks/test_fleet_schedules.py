# SPDX-License-Identifier: Apache-2.0
"""A change of many boards under thousands of schedules of crashes, losses, repeats and failures, each from a seed."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import pytest
from fleet_world import CHANGE, NEW, OLD, Network, World, ended

from cm.networks.fleet.change import member, seats
from cm.networks.fleet.change.asks import Ask, Verb
from cm.networks.fleet.change.coordinator import Outcome
from cm.networks.fleet.change.seats import most
from cm.wire.messages.fleet import Decision, FleetRecord, FleetStep, Policy

SCHEDULES = 85  # for each of 12 parts


def size_of(chance: random.Random) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    """Boards of the fleet, members of the change, and its seats."""
    size = chance.randint(1, 6)
    there = [f"b{n}" for n in range(size)]
    members = tuple(sorted(chance.sample(there, chance.randint(1, size))))
    return size, members, seats.chosen(members, there)


async def course(seed: int) -> None:
    """One schedule: a change whose client may die, boards that die or vanish for good, another client that recovers."""
    chance = random.Random(f"course {seed}")
    size, members, where = size_of(chance)
    world = World(seed, size, where)
    policy = chance.choice(list(Policy))
    for board in world.boards.values():
        board.failing, board.away = chance.random() < 0.1, chance.choice((0.0, 0.0, 0.3))
    client = asyncio.create_task(world.change(policy, members))
    await world.run(
        asyncio.create_task(some_turns(world, chance, client)), client, trouble=chance.choice((0.0, 0.03)), lost=1
    )
    helped = asyncio.create_task(world.recover()) if chance.random() < 0.5 else None
    await world.heal()
    if helped is not None:
        await world.run(helped)
    judge(world, where)


async def some_turns(world: World, chance: random.Random, client: asyncio.Task[Any]) -> None:
    """Let some turns pass and then kill the client, usually before it is done."""
    for _ in range(chance.choice((0, 5, 20, 40, 80, 400))):
        await world.network.turn()
    await ended(client)


def judge(world: World, where: tuple[str, ...]) -> None:
    """There is one decision; each remaining board follows it, or its record says that it does not."""
    decisions = world.decisions()
    assert len(decisions) <= 1
    decided = next(iter(decisions), Decision.REVERT)
    enough = sum(not world.boards[seat].gone for seat in where) >= most(where)
    for name, board in world.boards.items():
        record = board.record
        if board.gone:
            continue
        if record is None or record.state == member.OPEN:
            assert board.place == OLD, name
        elif enough or record.decision is not None:
            assert member.ended(record), (name, record)
            assert not board.held, name
            if not member.differs(record):
                assert board.place == (NEW if decided is Decision.KEEP else OLD), (name, record)
        else:  # it waits, and says so
            assert record.decision is None
            assert board.held


@pytest.mark.parametrize("part", range(12))
def test_whatever_ends_or_is_lost_there_is_one_decision_and_boards_that_differ_say_so(part: int) -> None:
    for number in range(SCHEDULES):
        seed = part * SCHEDULES + number
        try:
            asyncio.run(course(seed))
        except AssertionError as error:
            raise AssertionError(f"schedule {seed}: {error}") from error


def test_without_failing_loads_all_boards_end_in_one_and_the_same_mode() -> None:
    """Under the policy that demands it: the client and a board are killed anywhere, one board for good."""

    async def one(seed: int) -> None:
        chance = random.Random(f"same {seed}")
        world = World(seed, 4)
        client = asyncio.create_task(world.change())
        await world.run(asyncio.create_task(some_turns(world, chance, client)), client, trouble=0.02, lost=1)
        await world.heal()
        assert len({board.place for board in world.boards.values() if not board.gone}) == 1, seed

    for seed in range(150):
        asyncio.run(one(seed))


async def killed_at(step: int, gone: tuple[str, ...], size: int) -> tuple[World, bool]:
    """A fleet whose client and these boards vanish for good at a step; also whether that was during the change."""
    world = World(step, size)
    world.network.lossy = False
    client = asyncio.create_task(world.change())
    await asyncio.sleep(0)
    for _ in range(step):
        await world.network.go_on()
    amid = not client.done()
    client.cancel()
    for name in gone:
        world.boards[name].kill(for_good=True)
    return world, amid


async def another_client(world: World) -> Outcome | None:
    helped = asyncio.create_task(world.recover())
    await world.run(helped)
    return helped.result()


@pytest.mark.parametrize("victim", ["b0", "b1", "b2"])
def test_the_coordinator_and_a_seat_gone_for_good_at_any_step_leave_the_rest_to_another_client(victim: str) -> None:
    """The seat's records are deleted with it. Another client is told where the boards really are."""

    async def one(step: int) -> tuple[Decision | None, bool]:
        world, amid = await killed_at(step, (victim,), 4)
        outcome = await another_client(world)
        places = {board.place for name, board in world.boards.items() if name != victim}
        assert len(places) == 1, step
        if outcome is None:  # nobody had prepared yet
            assert places == {OLD}
            return None, amid
        assert outcome.decision is not None
        assert places == {NEW if outcome.decision is Decision.KEEP else OLD}
        assert set(outcome.differing) <= {victim}
        return outcome.decision, amid

    seen = outcomes_at_every_step(one)
    assert set(seen) == {None, Decision.REVERT, Decision.KEEP}
    assert len(seen) > 50


def outcomes_at_every_step(one: Callable[[int], Coroutine[Any, Any, tuple[Any, bool]]]) -> list[Any]:
    """From before the first message to after the last."""
    found = []
    while True:
        outcome, amid = asyncio.run(one(len(found)))
        found.append(outcome)
        if not amid:
            return found


def test_with_most_seats_gone_for_good_the_rest_are_named_or_one_of_them_knows() -> None:
    async def one(step: int) -> tuple[Decision | str | None, bool]:
        world, amid = await killed_at(step, ("b0", "b1"), 5)
        outcome = await another_client(world)
        if outcome is None:
            return "nothing", amid
        rest = [world.boards[name] for name in ("b2", "b3", "b4")]
        if outcome.decision is not None:
            assert len({board.place for board in rest}) == 1
            return outcome.decision, amid
        waiting = {b.name for b in rest if b.record is not None and b.record.state != member.OPEN}
        assert waiting
        assert waiting | {"b0", "b1"} == set(outcome.differing)
        return None, amid

    seen = outcomes_at_every_step(one)
    assert {"nothing", None, Decision.KEEP} == set(seen)


def test_the_record_on_disk_is_the_changes_own() -> None:
    async def one() -> None:
        world = World(1, 3)
        world.network.lossy = False
        task = asyncio.create_task(world.change())
        await world.run(task)
        assert task.result().outcome.decision is Decision.KEEP
        record = world.boards["b2"].disk.last()
        assert record is not None
        assert (record.id, record.seats, record.vote, record.state) == (
            CHANGE,
            ("b0", "b1", "b2"),
            Decision.KEEP,
            "new",
        )

    asyncio.run(one())


# ---- the seats alone ------------------------------------------------------------------------


async def race(seed: int) -> None:
    """The coordinator and recovering clients vote at once, with losses; no decision is ever announced."""
    chance = random.Random(f"race {seed}")
    network = Network(chance)
    where = tuple(f"b{n}" for n in range(chance.choice((1, 3, 3, 3, 5))))
    records: dict[str, FleetRecord] = {}
    chosen: set[Decision] = set()

    async def one(ask: Ask) -> FleetRecord | None:
        await network.turn()
        if chance.random() < 0.2:
            return None
        known = records.get(ask.board)
        try:
            settles = ask.verb is Verb.SETTLE
            record = seats.promised(known, CHANGE, ask.step.ballot) if settles else seats.voted(known, ask.step)
        except member.NotNow:
            return None
        records[ask.board] = record
        votes = [seats.counted(records.values(), where, ballot) for ballot in range(20)]
        chosen.update(vote for vote in votes if vote is not None)
        await network.turn()
        return None if chance.random() < 0.2 else record

    async def ask_all(asks: Sequence[Ask]) -> dict[str, FleetRecord]:
        answers = await asyncio.gather(*map(one, asks))
        return {ask.board: answer for ask, answer in zip(asks, answers, strict=True) if answer is not None}

    async def coordinator() -> Decision | None:
        step = FleetStep(CHANGE, seats=where, keep=True)
        return seats.counted((await ask_all([Ask(n, Verb.VOTE, step) for n in where])).values(), where, 0)

    async def another() -> Decision | None:
        for _ in range(chance.randrange(30)):
            await network.turn()
        return await seats.agreed(CHANGE, where, ask_all, tries=2)

    work = [asyncio.create_task(each) for each in (coordinator(), *(another() for _ in range(4)))]
    while not all(task.done() for task in work):
        await network.go_on()
    said = {task.result() for task in work} - {None}
    assert len(said | chosen) <= 1, seed


def test_however_many_want_an_end_at_once_the_seats_never_say_two_things() -> None:
    for seed in range(250):
        asyncio.run(race(seed))


def test_a_seat_that_promised_while_it_prepared_has_no_part_in_the_change() -> None:
    """Otherwise its record would be overwritten, and the promise lost."""
    world = World(1, 1)

    async def one() -> None:
        participant = world.boards["b0"].commands._participant
        step = FleetStep(CHANGE, *NEW, ("b0",), ("b0",))
        preparing = asyncio.create_task(participant.prepare(step, "anna"))
        await world.network.go_on()
        participant.settle(FleetStep(CHANGE, ballot=1))
        while not preparing.done():
            await world.network.go_on()
        assert isinstance(preparing.exception(), member.NotNow)
        assert not world.boards["b0"].held
        record = world.boards["b0"].record
        assert record is not None
        assert record.promised == 1

    asyncio.run(one())


def test_a_ballot_is_promised_once_and_a_vote_is_a_promise_too() -> None:
    record = seats.promised(None, CHANGE, 3)
    for ballot in (3, 2):
        with pytest.raises(member.NotNow, match="ballot 3 is promised"):
            seats.promised(record, CHANGE, ballot)
    with pytest.raises(member.NotNow, match="ballot 3 is promised here, 0 comes too late"):
        seats.voted(record, FleetStep(CHANGE, keep=True))
    voted = seats.voted(record, FleetStep(CHANGE, keep=True, ballot=5))
    assert (voted.vote, voted.vote_ballot) == (Decision.KEEP, 5)
    with pytest.raises(member.NotNow, match="ballot 5 is promised"):
        seats.promised(voted, CHANGE, 4)


def test_votes_of_different_ballots_are_not_counted_together() -> None:
    def vote(ballot: int) -> FleetRecord:
        return seats.voted(None, FleetStep(CHANGE, keep=True, ballot=ballot))

    where = ("b0", "b1", "b2")
    assert seats.counted([vote(1), vote(2)], where, 1) is None
    assert seats.counted([vote(1), vote(1)], where, 1) is Decision.KEEP


@pytest.mark.parametrize(
    ("members", "others", "where"),
    [("a", "bc", "a"), ("ab", "", "a"), ("ab", "bcd", "abc"), ("abcd", "e", "abc"), ("ab", "cd", "abc")],
)
def test_seats_are_three_boards_where_there_are_three_that_have_an_interest(
    members: str, others: str, where: str
) -> None:
    assert seats.chosen(members, others) == tuple(where)
