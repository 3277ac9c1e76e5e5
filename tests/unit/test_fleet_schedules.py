# SPDX-License-Identifier: Apache-2.0
"""Changes of many boards under schedules of deaths, losses, repeats, a store that goes away, and local changes.

Each schedule comes from its number. ``CM_SCHEDULES=20000`` runs as many (`make soak`).
"""

from __future__ import annotations

import asyncio
import os
import random
from collections.abc import Mapping, Sequence
from typing import Any

import pytest
from fleet_world import HOME, World, killed

from cm.networks.fleet.reconciling_board import Place
from cm.networks.fleet.store import Claim, Entry, Put, Wanted, key, packed
from cm.wire.messages.fleet import Decision, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo

PARTS = 10
SCHEDULES = int(os.environ.get("CM_SCHEDULES", "400")) // PARTS
MODES = ("edge", "colorise", "default", "loop")


def meanwhile(world: World, trouble: float) -> None:
    """What happens between two turns."""
    chance = world.chance
    if chance.random() < 0.15:
        world.beat(chance.choice(sorted(world.boards)))
    if chance.random() < 0.02:
        world.now += chance.choice((0.1, 1.0, 3.0, 7.0))
    if chance.random() >= trouble:
        return
    board = world.boards[chance.choice(sorted(world.boards))]
    what = chance.random()
    if what < 0.4:
        board.kill()
    elif what < 0.5:
        board.lose_power()
    elif what < 0.6:
        board.gone = not board.gone
    elif what < 0.65:
        board.full = not board.full
    elif what < 0.8:
        world.store_down = not world.store_down
    else:
        board.operate(("camera", chance.choice(MODES)))


async def course(number: int) -> None:
    """One to three clients, each with a change or two, of which some die; then all is there for the lease and 5 s."""
    chance = random.Random(f"course {number}")
    world = World(f"world {number}", chance.randint(1, 5))
    trouble = chance.choice((0.0, 0.02, 0.08))
    for board in world.boards.values():
        board.failing, board.away = chance.random() < 0.1, chance.choice((0.0, 0.0, 0.2))
        board.breaking = chance.random() < 0.3
    clients: list[asyncio.Task[Any]] = []
    for caller in ("anna", "bob", "carl")[: chance.randint(1, 3)]:
        members = chance.sample(sorted(world.boards), chance.randint(1, len(world.boards)))
        away = chance.sample(members, chance.choice((0, 0, 1))) if len(members) > 1 else []

        async def changing(caller: str, members: list[str], away: list[str]) -> None:
            for _ in range(chance.randint(1, 2)):  # the second begins with what the first has left in the store
                goal: Place = ("camera", chance.choice(MODES))
                await world.change(caller, goal, members, chance.choice(list(Policy)), away)

        clients.append(asyncio.create_task(changing(caller, members, away)))
        for _ in range(chance.choice((0, 20, 60, 200))):
            meanwhile(world, trouble)
            await world.go_on()
    for client in clients:
        if chance.random() < 0.5:
            await killed(client, world)
    await world.run(*clients, meanwhile=lambda: meanwhile(world, trouble))
    await world.heal()
    world.now += 300.0  # after which at last what has failed is tried again
    await world.heal(3.0)
    world.judge()


@pytest.mark.parametrize("part", range(PARTS))
def test_whatever_dies_or_is_lost_every_board_ends_where_it_is_wanted(part: int) -> None:
    for number in range(part * SCHEDULES, (part + 1) * SCHEDULES):
        try:
            asyncio.run(course(number))
        except AssertionError as error:
            raise AssertionError(f"schedule {number}: {error}") from error


async def cut(step: int, policy: Policy = Policy.ALL) -> tuple[World, bool]:
    """A change of three boards whose coordinator dies at a step; also whether it was still at work."""
    world = World(1, 3)
    world.lossy = False
    client = asyncio.create_task(world.change("anna", ("camera", "edge"), sorted(world.boards), policy))
    await asyncio.sleep(0)
    for _ in range(step):
        await world.go_on()
    amid = not client.done()
    await killed(client, world)
    return world, amid


def test_a_coordinator_that_dies_at_any_step_leaves_all_boards_in_one_mode_with_their_registers() -> None:
    async def one(step: int) -> tuple[Place, bool]:
        world, amid = await cut(step)
        await world.heal()
        world.judge()
        (place,) = {board.place for board in world.boards.values()}
        (register,) = {board.register for board in world.boards.values()}
        assert register == (7 if place == HOME else 1)
        return place, amid

    ends, step = [], 0
    while True:
        place, amid = asyncio.run(one(step))
        ends.append(place)
        if not amid:
            break
        step += 1
    assert set(ends) == {HOME, ("camera", "edge")}
    assert ends == sorted(ends)  # once it is wanted, it stays so
    assert len(ends) > 40


async def amid(trouble: str, step: int, whose: tuple[str, ...]) -> tuple[Decision | str | None, bool]:
    """What is told of a change of which one request to the store ends badly; also whether there are so many."""
    world = World(1, 3)
    world.lossy, world.trouble, world.trouble_at, world.troubled = False, trouble, step, whose
    client = asyncio.create_task(world.change("anna", ("camera", "edge"), sorted(world.boards), Policy.ALL))
    await world.run(client)
    reached = world.asked >= step
    await world.heal()
    world.judge()
    if client.result() is not None:
        return client.result().decision, reached
    assert world.history == {}
    assert {seen.place for board in world.boards.values() for seen in board.told} == {HOME}, "a board was changed"
    return "nothing was changed", reached


@pytest.mark.parametrize("whose", [("coordinator",), ("coordinator", "board")])
@pytest.mark.parametrize("trouble", ["lost", "asked again", "refused"])
def test_whichever_answer_of_the_store_is_lost_or_a_refusal_what_is_told_is_what_was_done(
    trouble: str, whose: tuple[str, ...]
) -> None:
    ends: list[Decision | str | None] = []
    while True:
        end, reached = asyncio.run(amid(trouble, len(ends) + 1, whose))
        if not reached:
            break
        ends.append(end)
    nothing, back, kept = "nothing was changed", Decision.REVERT, Decision.KEEP
    if len(whose) > 1:
        assert set(ends) <= {nothing, back, kept}
    else:
        assert (
            ends
            == {
                "asked again": [kept] * 3,
                "lost": [nothing, *[kept] * (len(ends) - 1)],  # what it reads first
                "refused": [nothing, nothing, back, *[kept] * (len(ends) - 3)],
            }[trouble]
        )


def test_two_changes_of_the_same_boards_come_one_after_the_other() -> None:
    async def one(seed: int) -> None:
        world = World(seed, 4)
        world.lossy = False
        names = sorted(world.boards)
        both = [
            asyncio.create_task(world.change("anna", ("camera", "edge"), names[:3], Policy.ALL)),
            asyncio.create_task(world.change("bob", ("camera", "loop"), names[1:], Policy.ALL)),
        ]
        await world.run(*both)
        assert [task.result().decision for task in both] == [Decision.KEEP, Decision.KEEP]
        await world.heal()
        world.judge()
        modes = [world.boards[name].place[1] for name in names]
        assert modes in (["edge", "loop", "loop", "loop"], ["edge", "edge", "edge", "loop"])

    for seed in range(30):
        asyncio.run(one(seed))


@pytest.mark.parametrize("seconds", [0.3, 3.0])
def test_boards_that_are_asked_before_the_store_wait_for_its_word_and_are_asked_again(seconds: float) -> None:
    world = World(1, 3)
    world.lossy, world.slow = False, seconds

    async def run() -> None:
        client = asyncio.create_task(world.change("anna", ("camera", "edge"), sorted(world.boards), Policy.ALL))
        await world.run(client)
        assert client.result().decision is Decision.KEEP
        assert client.result().differing == {}
        assert [leg.phase for leg in client.result().legs] == ["open", "prepare", "apply", "decide", "reconcile"]

    asyncio.run(run())


def test_a_clients_next_change_begins_with_its_claim_if_nobody_else_has_changed_anything() -> None:
    world = World("again", 3)
    world.lossy, world.troubled = False, ("coordinator",)
    asked: list[int] = []

    async def run(*clients: str) -> None:
        for client, mode in zip(clients, MODES, strict=False):
            before = world.asked
            work = asyncio.create_task(world.change(client, ("camera", mode), sorted(world.boards), Policy.ALL))
            await world.run(work)
            assert work.result().decision is Decision.KEEP
            assert work.result().differing == {}
            asked.append(world.asked - before)

    asyncio.run(run("anna", "anna", "bob", "anna"))
    assert asked == [3, 2, 3, 3]  # read, claim, decide; bob's is seen by anna's claim, which is asked for once more
    world.judge()


class Alone:
    """A board that is asked by hand."""

    def __init__(self) -> None:
        self.world = World("alone", 1)
        self.world.lossy = False
        self.b0 = self.world.boards["b0"]

    async def asks(self, verb: str, change: str, generation: int, mode: str = "edge") -> str:
        step = FleetStep(change, "camera", mode, generation)
        work = asyncio.create_task(self.world._delivered("b0", verb, step, "anna"))
        await self.world.run(work)
        found = work.result()
        return found.code if isinstance(found, ErrorInfo) else found.state

    def claims(self, change: str, generation: int) -> None:
        claim = packed(Claim(generation, change, "anna"))
        self.world.ledger.claim({}, {key("b0", "claim"): Put(claim, "7")}, "7", 5)

    def wants(self, change: str, generation: int) -> None:
        wanted = packed(Wanted(generation, "camera", "loop", "anna", change, self.world.now))
        puts = {key("b0", "wanted"): Put(wanted), key("b0", "claim"): None}
        assert self.world.ledger.txn({}, puts)
        self.world.wanted(puts)


def test_a_board_that_was_prepared_without_a_claim_goes_nowhere_and_is_free_when_it_looks() -> None:
    async def run(alone: Alone) -> None:
        assert await alone.asks("prepare", "c1", 1) == "prepared"
        assert await alone.asks("apply", "c1", 1) == "fleet_state"
        assert (alone.b0.place, alone.b0.board.state.state) == (HOME, "prepared")
        await alone.world.heal(1.0)
        alone.world.judge()
        assert (alone.b0.board.state.state, alone.b0.held_until) == ("free", 0.0)
        assert await alone.asks("apply", "c1", 1) == "fleet_state"

    asyncio.run(run(Alone()))


def test_a_board_that_nobody_has_claimed_is_free_soon_while_the_store_is_away() -> None:
    async def run(alone: Alone) -> None:
        alone.world.now = 1.0
        assert await alone.asks("prepare", "c1", 1) == "prepared"
        alone.world.store_down = True
        for seconds, held in ((1.0, True), (1.1, False)):
            alone.world.now += seconds
            await alone.world.run(asyncio.create_task(alone.b0.board.look()))
            assert (alone.b0.held_until > 0) is held
        assert alone.b0.read().part is None

    asyncio.run(run(Alone()))


def test_a_coordinator_whose_claim_is_refused_has_boards_look_and_they_are_free_though_the_store_is_away() -> None:
    asked: list[str] = []

    class Heard(World):
        def ask(self, boards: Sequence[str], verb: str, *rest: Any) -> Any:
            asked.append(verb)
            return super().ask(boards, verb, *rest)

    async def change(world: World) -> Any:
        work = asyncio.create_task(world.change("anna", ("camera", "edge"), sorted(world.boards), Policy.ALL))
        await world.run(work)
        return work.result()

    world = Heard("given up", 3)
    world.lossy, world.trouble, world.trouble_at, world.troubled = False, "refused", 2, ("coordinator",)
    assert asyncio.run(change(world)) is None
    assert asked == ["prepare", "reconcile"]

    async def run(alone: Alone) -> None:
        assert await alone.asks("prepare", "c1", 1) == "prepared"
        alone.world.store_down = True
        assert await alone.asks("reconcile", "c2", 0) == "prepared"
        assert await alone.asks("reconcile", "c1", 0) == "free"
        assert alone.b0.held_until == 0.0

    asyncio.run(run(Alone()))


def test_of_two_changes_that_were_prepared_that_counts_which_has_the_claim() -> None:
    async def run(alone: Alone) -> None:
        assert await alone.asks("prepare", "c1", 1) == "prepared"
        alone.claims("c2", 1)
        assert await alone.asks("prepare", "c2", 1, "colorise") == "prepared"
        assert await alone.asks("apply", "c1", 1) == "fleet_state"
        assert await alone.asks("apply", "c2", 1) == "changed"
        assert alone.b0.place == ("camera", "colorise")
        alone.world.now += 6.0  # its coordinator is gone
        await alone.world.heal()
        alone.world.judge()
        assert alone.b0.place == HOME

    asyncio.run(run(Alone()))


def test_a_board_that_prepared_before_it_heard_of_an_earlier_decision_does_not_apply() -> None:
    async def run(alone: Alone) -> None:
        alone.b0.board.told({})
        await alone.world.heal(1.0)
        alone.b0.gone = True
        alone.wants("c1", 1)
        await alone.world.run()
        alone.b0.gone = False
        assert await alone.asks("prepare", "c2", 2) == "prepared"
        alone.claims("c2", 2)
        assert await alone.asks("apply", "c2", 2) == "fleet_state"
        alone.world.now += 6.0
        await alone.world.heal()
        alone.world.judge()
        assert alone.b0.place == ("camera", "loop")

    asyncio.run(run(Alone()))


@pytest.mark.parametrize("first", ["the fleet", "an operator"])
def test_what_is_newer_counts_whoever_notices_it_when(first: str) -> None:
    """A board whose bridge is away is wanted elsewhere, and taken elsewhere by hand: in either order."""

    async def run(world: World) -> None:
        b0, loop = world.boards["b0"], ("camera", "loop")
        await world.heal(1.0)  # it knows where it is
        b0.gone = True

        async def wish() -> None:
            client = asyncio.create_task(
                world.change("anna", ("camera", "edge"), sorted(world.boards), Policy.ALL, ("b0",))
            )
            await world.run(client)
            assert client.result().decision is Decision.KEEP
            world.now += 60.0

        if first == "the fleet":
            await wish()
        b0.operate(loop)
        world.now += 60.0
        if first == "an operator":
            await wish()
        await world.heal()
        world.judge()
        assert b0.place == (loop if first == "the fleet" else ("camera", "edge"))
        assert b0.board.state.state == ("drift" if first == "the fleet" else "there")

    world = World("order", 2)
    world.lossy = False
    asyncio.run(run(world))


def test_a_board_whose_way_back_fails_is_told_as_failed_and_repaired_when_loads_work_again() -> None:
    async def change(world: World, mode: str) -> Any:
        client = asyncio.create_task(world.change("anna", ("camera", mode), sorted(world.boards), Policy.ALL))
        await world.run(client)
        return client.result()

    async def run(world: World) -> None:
        assert (await change(world, "edge")).decision is Decision.KEEP
        b0 = world.boards["b0"]
        b0.failing = b0.breaking = True
        course = await change(world, "loop")
        assert course.decision is Decision.REVERT
        assert course.differing == {"b0": "the bitstream did not start"}
        assert (b0.place, b0.board.state.state) == (("camera", ""), "failed")
        await world.heal()
        world.judge()
        assert (b0.place, b0.board.state.state) == (("camera", "edge"), "there")

    world = World("broken", 2)
    world.lossy = False
    asyncio.run(run(world))


def test_a_board_that_cannot_write_its_part_down_is_not_kept_from_others() -> None:
    async def run(world: World) -> None:
        world.boards["b0"].full = True
        client = asyncio.create_task(world.change("anna", ("camera", "edge"), sorted(world.boards), Policy.ALL))
        await world.run(client)
        assert client.result().causes["b0"].message == "[Errno 28] no space left"
        assert world.boards["b0"].held_until == 0.0
        await world.heal()
        world.judge()

    world = World("full", 2)
    world.lossy = False
    asyncio.run(run(world))


@pytest.mark.parametrize("size", [1, 64, 65])
def test_a_decision_ends_the_claims_and_what_does_not_fit_into_its_transaction_ends_with_the_lease(size: int) -> None:
    told = []

    class Watched(World):
        def tell(self, changes: Mapping[str, Entry]) -> None:
            told.append({name for name in changes if name.startswith("boards/b0/")})
            super().tell(changes)

    async def change(world: World) -> Any:
        changing = asyncio.create_task(world.change("anna", ("camera", "edge"), sorted(world.boards), Policy.ALL))
        await world.run(changing)
        return changing.result()

    world = Watched("claims", size)
    world.lossy = False
    course = asyncio.run(change(world))
    assert course.decision is Decision.KEEP
    assert not course.differing
    assert not [name for name in world.ledger.get("") if name.endswith("/claim")]
    wanted, claim = "boards/b0/wanted", "boards/b0/claim"
    assert told == [{claim}, *([{wanted, claim}] if size <= 64 else [{wanted}, {claim}])]
