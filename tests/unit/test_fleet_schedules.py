# SPDX-License-Identifier: Apache-2.0
"""Changes of many boards under schedules of deaths, losses, repeats, a store that goes away, and local changes.

Each schedule comes from its number. ``CM_SCHEDULES=20000`` runs as many (`make soak`).
"""

from __future__ import annotations

import asyncio
import os
import random
from collections.abc import Mapping
from typing import Any

import pytest
from fleet_world import HOME, World, killed

from cm.networks.fleet.reconciling_board import Place
from cm.networks.fleet.store import Entry
from cm.wire.messages.fleet import Decision, Policy

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
    """One to three coordinators, of which some die; then everything is there again for the lease and 5 s."""
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
        goal: Place = ("camera", chance.choice(MODES))
        changing = world.change(caller, goal, members, chance.choice(list(Policy)), away)
        clients.append(asyncio.create_task(changing))
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
                "asked again": [kept] * 4,
                "lost": [nothing, nothing, *[kept] * (len(ends) - 2)],  # two: what it reads first, and its lease
                "refused": [nothing, nothing, nothing, back, *[kept] * (len(ends) - 4)],
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
