# SPDX-License-Identifier: Apache-2.0
"""A change of many boards as a transaction: coordinator and boards, example by example.

Without sockets, files or time: coroutines are run by hand, and a killed process is an exception in one of the
calls that leave it, before or after the call had its effect.
"""

from __future__ import annotations

import random
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import pytest

from cm.cli.parser import build_parser
from cm.errors import Busy, CmError, InvalidRequest
from cm.networks.fleet.change import member
from cm.networks.fleet.change.asks import Ask, Verb
from cm.networks.fleet.change.coordinator import Coordinator, first_step
from cm.networks.fleet.change.member import NotNow
from cm.networks.fleet.change.participant import Participant
from cm.networks.fleet.change.ports import Planned, Unsettled
from cm.networks.fleet.change.seats import agreed
from cm.wire.messages.fleet import Decision, FleetRecord, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo

T = TypeVar("T")
OLD, NEW = ("camera", "default"), ("camera", "edge")
SILENT = ErrorInfo("vanished", "it vanished")


class Killed(BaseException):
    """The process was killed here."""


def done(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine that never waits."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]
    raise AssertionError("it waits")


class Disk:
    def __init__(self, fate: Fate) -> None:
        self._fate = fate
        self.records: dict[str, FleetRecord] = {}
        self.newest = ""

    def read(self, change: str) -> FleetRecord | None:
        return self.records.get(change)

    def last(self) -> FleetRecord | None:
        return self.records.get(self.newest)

    def write(self, record: FleetRecord) -> None:
        self._fate.may_end()
        if record.state != member.OPEN:
            self.newest = record.id
        self.records[record.id] = record
        self._fate.may_end()


@dataclass
class Fate:
    """What goes wrong at a board: kills, by the number of the call, and loads that fail."""

    kills: set[int] = field(default_factory=set)
    failures: set[int] = field(default_factory=set)
    calls: int = 0
    loads: int = 0
    away: dict[int, bool] = field(default_factory=dict)  # by load: the manager ends in it; whether it had its effect

    def may_end(self) -> None:
        self.calls += 1
        if self.calls in self.kills:
            raise Killed

    def load_fails(self) -> bool:
        self.loads += 1
        return self.loads in self.failures


class LoadFailed(CmError):
    code = "load_failed"


class Board:
    """A board with its manager and its bridge."""

    def __init__(self, world: World, name: str) -> None:
        self.fate = Fate()
        self.disk = Disk(self.fate)
        self.place = OLD
        self.name = name
        self.world = world
        self.reachable = True
        self.held = False
        self.participant = self._participant()

    def _participant(self) -> Participant:
        return Participant(self.name, self.disk, self, self, lambda: self.world.now)

    def restart(self) -> None:
        self.participant = self._participant()

    async def where(self) -> tuple[str, str]:
        return self.place

    async def plan(self, config: str, mode: str, caller: str) -> Planned:
        self.fate.may_end()
        if self.world.refuses == self.name:
            raise InvalidRequest("no such mode")
        return Planned(config or self.place[0], mode, 0.1, 100)

    async def hold(self, record: FleetRecord) -> None:
        self.fate.may_end()
        self.held = True

    async def release(self, record: FleetRecord) -> None:
        self.fate.may_end()
        self.held = False

    async def load(self, config: str, mode: str, caller: str) -> float:
        self.fate.may_end()
        if self.fate.load_fails():
            raise LoadFailed("the bitstream did not start")
        had_effect = self.fate.away.pop(self.fate.loads, None)
        self.place = (config, mode) if had_effect is not False else self.place
        if had_effect is not None:
            raise Unsettled("the manager went away")
        self.fate.may_end()
        return 0.1

    async def ask(self, asks: Sequence[Ask]) -> dict[str, FleetRecord]:
        found = {ask.board: self.world.asks(ask) for ask in asks}
        return {name: record for name, record in found.items() if record is not None}

    def take(self, ask: Ask) -> FleetRecord | ErrorInfo | None:
        """Handle a message; return None if it or its answer is lost."""
        try:
            return self.at_once(ask) if ask.verb in (Verb.VOTE, Verb.SETTLE) else done(self._do(ask))
        except Killed:
            self.restart()
            return None
        except CmError as error:
            return ErrorInfo(error.code, str(error))

    def _do(self, ask: Ask) -> Coroutine[Any, Any, FleetRecord]:
        if ask.verb is Verb.PREPARE:
            return self.participant.prepare(ask.step, "anna")
        return self.participant.apply(ask.step) if ask.verb is Verb.APPLY else self.participant.decide(ask.step)

    def at_once(self, ask: Ask) -> FleetRecord:
        """Answer what a board can answer at any time."""
        return self.participant.vote(ask.step) if ask.verb is Verb.VOTE else self.participant.settle(ask.step)

    def go_on(self) -> None:
        try:
            done(self.participant.go_on())
        except Killed:
            self.restart()
        except Unsettled:
            pass


class World:
    def __init__(self, boards: int, refuses: str = "") -> None:
        self.now = 0.0
        self.refuses = refuses
        self.boards = {f"b{n}": Board(self, f"b{n}") for n in range(boards)}

    def asks(self, ask: Ask) -> FleetRecord | None:
        board = self.boards[ask.board]
        answer = board.take(ask) if board.reachable else None
        return answer if isinstance(answer, FleetRecord) else None

    def coordinator(self, policy: Policy = Policy.ALL) -> Coordinator:
        return Coordinator(first_step("c1", self.boards, "camera", "edge", policy, 30.0))

    def run(self, coordinator: Coordinator, chance: random.Random | None = None, ends_after: int = 10**6) -> bool:
        """Run until it is done, or the coordinator dies after some answers; messages arrive in any order."""
        asks = coordinator.start()
        for _ in range(ends_after):
            if not asks:
                return True
            ask = asks.pop(chance.randrange(len(asks)) if chance else 0)
            lost = chance is not None and chance.random() < 0.08
            answer = None if lost else self.boards[ask.board].take(ask)
            if chance is not None and answer is not None and chance.random() < 0.08:
                answer = self.boards[ask.board].take(ask)  # it came twice
            if answer is None or (chance is not None and chance.random() < 0.05):
                asks += coordinator.heard_nothing(ask, SILENT)
            else:
                asks += coordinator.answered(ask, answer)
            self._meanwhile(chance)
        return not asks

    def _meanwhile(self, chance: random.Random | None) -> None:
        if chance is None:
            return
        self.now += chance.choice((0.0, 1.0, 40.0))
        if chance.random() < 0.3:
            chance.choice(list(self.boards.values())).go_on()

    def heal(self) -> None:
        """Let time pass without further faults."""
        for board in self.boards.values():
            board.fate = board.disk._fate = Fate()
            board.reachable = True
            board.restart()
        for _ in range(3):
            self.now += 100.0
            for board in self.boards.values():
                board.go_on()

    @property
    def places(self) -> set[tuple[str, str]]:
        return {board.place for board in self.boards.values()}

    def decision(self) -> Decision:
        """The decision; a change unknown to the seat has been reverted."""
        record = self.boards["b0"].disk.read("c1")
        return record.decision if record and record.decision else Decision.REVERT


# ---- examples ---------------------------------------------------------------------------


def test_all_boards_go_to_the_new_mode() -> None:
    world = World(3)
    coordinator = world.coordinator()
    assert world.run(coordinator)
    outcome = coordinator.outcome()
    assert (outcome.decision, outcome.differing, world.places) == (Decision.KEEP, {}, {NEW})


def test_a_board_that_refuses_the_plan_leaves_all_where_they_were() -> None:
    world = World(3, refuses="b1")
    coordinator = world.coordinator()
    assert world.run(coordinator)
    outcome = coordinator.outcome()
    assert (outcome.decision, outcome.differing, world.places) == (Decision.REVERT, {}, {OLD})
    assert outcome.causes == {"b1": ErrorInfo("invalid_request", "no such mode")}
    assert all(board.fate.loads == 0 for board in world.boards.values())


def test_a_load_that_fails_takes_all_back() -> None:
    world = World(3)
    world.boards["b2"].fate.failures = {1}
    coordinator = world.coordinator()
    assert world.run(coordinator)
    outcome = coordinator.outcome()
    assert (outcome.decision, outcome.differing, world.places) == (Decision.REVERT, {}, {OLD})
    assert outcome.causes["b2"].code == "load_failed"


def test_a_board_with_nothing_loaded_is_refused_with_the_policy_that_takes_it() -> None:
    world = World(1)
    board = world.boards["b0"]
    board.place = ("", "")
    step = FleetStep("c1", "camera", "edge", ("b0",), ("b0",))
    with pytest.raises(InvalidRequest, match="no way back") as refused:
        done(board.participant.prepare(step, "anna"))
    policy = str(refused.value).split()[-1]
    taken = build_parser("fleet").parse_args(["fleet", "load", "camera", "edge", "--policy", policy])
    done(board.participant.prepare(replace(step, policy=Policy.of(taken.policy)), "anna"))


ENOUGH = [("quorum", 1, True), ("quorum", 2, False), ("best_effort", 3, True), ("best_effort", 4, False)]


@pytest.mark.parametrize(("policy", "failing", "stays"), ENOUGH)
def test_policies_say_how_many_are_enough_and_failed_boards_are_named(policy: str, failing: int, stays: bool) -> None:
    world = World(4)
    names = list(world.boards)[-failing:]
    for name in names:
        world.boards[name].fate.failures = {1}
    coordinator = world.coordinator(Policy(policy))
    assert world.run(coordinator)
    outcome = coordinator.outcome()
    assert outcome.decision is (Decision.KEEP if stays else Decision.REVERT)
    assert set(outcome.differing) == (set(names) if stays else set())


def test_a_board_that_was_away_comes_to_the_fleets_mode_by_its_own_record() -> None:
    world = World(3)
    coordinator = world.coordinator(Policy.QUORUM)
    asks = coordinator.start()
    for ask in asks:
        applies = coordinator.answered(ask, world.boards[ask.board].take(ask))  # type: ignore[arg-type]
    for ask in applies:
        if ask.board == "b2":
            asks = coordinator.heard_nothing(ask, SILENT)
        else:
            asks = coordinator.answered(ask, world.boards[ask.board].take(ask))  # type: ignore[arg-type]
    while asks:
        ask = asks.pop()
        answer = None if ask.board == "b2" else world.boards[ask.board].take(ask)
        asks += coordinator.heard_nothing(ask, SILENT) if answer is None else coordinator.answered(ask, answer)
    assert set(coordinator.outcome().differing) == {"b2"}
    assert world.boards["b2"].place == OLD
    world.heal()
    assert world.places == {NEW}


def test_a_late_coordinator_is_refused_by_seats_that_others_have_asked() -> None:
    world = World(2)
    assert done(agreed("c1", ("b0",), world.boards["b1"].ask)) is Decision.REVERT
    coordinator = world.coordinator()
    assert world.run(coordinator)
    assert coordinator.outcome().causes["b0"].code == "fleet_state"
    assert (coordinator.outcome().decision, world.places) == (Decision.REVERT, {OLD})


def test_a_change_that_was_reverted_is_not_started_first() -> None:
    """The manager went away before it did anything; then the decision to revert arrives."""
    world = World(1)
    board = world.boards["b0"]
    board.fate.away = {1: False}
    done(board.participant.prepare(FleetStep("c1", "camera", "edge", ("b0",), ("b0",)), "anna"))
    with pytest.raises(Unsettled):
        done(board.participant.apply(FleetStep("c1", seats=("b0",))))
    assert done(board.participant.decide(FleetStep("c1", seats=("b0",)))).state == member.OLD
    assert board.fate.loads == 1


def test_a_board_that_comes_back_does_not_load_again_what_is_loaded_already() -> None:
    world = World(1)
    board = world.boards["b0"]
    board.fate.away = {1: True}
    done(board.participant.prepare(FleetStep("c1", "camera", "edge", ("b0",), ("b0",)), "anna"))
    with pytest.raises(Unsettled):
        done(board.participant.apply(FleetStep("c1", seats=("b0",))))
    board.restart()
    done(board.participant.go_on())
    assert done(board.participant.decide(FleetStep("c1", seats=("b0",), keep=True))).state == member.NEW
    assert board.fate.loads == 1


def test_a_second_change_waits_for_the_end_of_the_first() -> None:
    world = World(1)
    participant = world.boards["b0"].participant
    done(participant.prepare(FleetStep("c1", "camera", "edge", ("b0",), ("b0",)), "anna"))
    with pytest.raises(Busy, match="change c1 of anna is prepared here"):
        done(participant.prepare(FleetStep("c2", "camera", "edge", ("b0",), ("b0",)), "bob"))
    done(participant.decide(FleetStep("c1", seats=("b0",))))
    done(participant.prepare(FleetStep("c2", "camera", "edge", ("b0",), ("b0",)), "bob"))


def test_a_board_with_nothing_loaded_has_no_way_back_and_is_refused() -> None:
    world = World(1)
    world.boards["b0"].place = ("", "")
    with pytest.raises(InvalidRequest, match="no way back"):
        done(world.boards["b0"].participant.prepare(FleetStep("c1", "camera", "edge", ("b0",), ("b0",)), "anna"))


def test_a_step_out_of_order_is_an_error_and_changes_nothing() -> None:
    participant = World(1).boards["b0"].participant
    with pytest.raises(NotNow, match="prepared no change"):
        done(participant.apply(FleetStep("c1", seats=("b1",))))
    with pytest.raises(NotNow, match="took no part"):
        done(participant.decide(FleetStep("c1", seats=("b1",), keep=True)))


def test_while_the_decision_is_unknown_every_board_is_named() -> None:
    """The seats voted, but nobody received the votes."""
    world = World(4)
    coordinator = world.coordinator()
    asks = coordinator.start()
    while asks:
        ask = asks.pop(0)
        answer = world.boards[ask.board].take(ask)
        if ask.verb is Verb.VOTE:  # it arrived; its answer did not
            asks += coordinator.heard_nothing(ask, SILENT)
        else:
            asks += coordinator.answered(ask, answer)  # type: ignore[arg-type]
    outcome = coordinator.outcome()
    assert outcome.decision is None
    assert set(outcome.differing) == {"b0", "b1", "b2", "b3"}
    assert "asks b0, b1, b2 for" in outcome.differing["b3"]
    world.heal()
    assert world.places == {NEW}
