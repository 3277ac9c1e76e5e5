# SPDX-License-Identifier: Apache-2.0
"""The coordinator: from boards' answers to the next requests, and to the outcome. Pure.

plan on all → prepare → apply → the decision, which most seats vote for → told to all

Until most seats have voted to keep it, no board stays in the new mode for good; afterwards every board that can does.
Boards that hear nothing ask the seats (`cm.networks.fleet.change.seats`), so it does not matter when the coordinator
ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from cm.networks.fleet.change import member, seats
from cm.networks.fleet.change.asks import Ask, Verb
from cm.wire.messages.fleet import Decision, FleetRecord, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo


class Phase(str, Enum):
    """How far a change is."""

    PREPARE = "prepare"
    APPLY = "apply"
    SEAT = "seat"  # the seats vote
    TELL = "tell"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a change ended.

    `decision` is None if nobody knows: too many seats went away while they voted. `records` are the boards' own,
    `silent` says why nothing is known of the others.
    """

    id: str
    decision: Decision | None
    records: Mapping[str, FleetRecord]
    silent: Mapping[str, ErrorInfo]
    seats: tuple[str, ...]
    causes: Mapping[str, ErrorInfo]  # what had gone wrong, and where, when it was decided

    @property
    def differing(self) -> dict[str, str]:
        """Boards that are not where the decision says, or may not be, each with the reason."""
        found = {name: _reason(record) for name, record in self.records.items() if member.differs(record)}
        return found | {name: error.message for name, error in self.silent.items()}


def _reason(record: FleetRecord) -> str:
    if record.decision is None:
        return f"it is {record.state} and waits for the decision, which it asks {', '.join(record.seats)} for"
    return record.error.message if record.error else f"it is {record.state}"


@dataclass
class Coordinator:
    """One change. Give it answers and missing ones; it returns the next requests."""

    step: FleetStep  # of preparing; its members are asked, its seats vote
    phase: Phase = Phase.PREPARE
    decision: Decision | None = None
    records: dict[str, FleetRecord] = field(default_factory=dict)
    silent: dict[str, ErrorInfo] = field(default_factory=dict)
    refused: dict[str, ErrorInfo] = field(default_factory=dict)
    causes: dict[str, ErrorInfo] = field(default_factory=dict)
    _waiting: dict[str, Ask] = field(default_factory=dict)
    _votes: dict[str, FleetRecord] = field(default_factory=dict)

    def start(self) -> list[Ask]:
        """Ask all to prepare."""
        return self._ask(self.step.members, Verb.PREPARE)

    def answered(self, ask: Ask, answer: FleetRecord | ErrorInfo) -> list[Ask]:
        """A board's answer; one that is late, or comes twice, changes nothing."""
        board = ask.board
        if self._waiting.get(board) != ask:
            return []
        if isinstance(answer, ErrorInfo):
            if self.phase is not Phase.SEAT:  # a seat that refuses to vote works for another coordinator
                self.refused[board] = answer
        else:
            self._take(board, answer)
        return self._went_on(board)

    def _take(self, board: str, record: FleetRecord) -> None:
        if self.phase is Phase.SEAT:
            self._votes[board] = record
        if board in self.step.members and record.state != member.OPEN:  # open: it has voted and took no other part
            self.records[board] = record
            self.silent.pop(board, None)

    def heard_nothing(self, ask: Ask, reason: ErrorInfo) -> list[Ask]:
        """The board vanished, or the time for its answer is over."""
        board = ask.board
        if self._waiting.get(board) != ask:
            return []
        if board in self.step.members:
            self.silent[board] = reason
        return self._went_on(board)

    @property
    def waiting(self) -> frozenset[str]:
        """The boards whose answers are awaited."""
        return frozenset(self._waiting)

    def outcome(self) -> Outcome:
        """The outcome as far as it is known now."""
        silent = {**self.silent, **{n: e for n, e in self.refused.items() if n not in self.records}}
        if self.decision is Decision.REVERT:  # a board that refused to prepare did nothing, and is where it was
            silent = {n: e for n, e in silent.items() if n not in self.refused or n in self.silent}
        known = {n: r for n, r in self.records.items() if n not in silent}
        return Outcome(self.step.id, self.decision, known, silent, self.step.seats, dict(self.causes))

    # ---- the steps ------------------------------------------------------------------------

    def _ask(self, boards: Iterable[str], verb: Verb, keep: bool = False) -> list[Ask]:
        step = self.step if verb is Verb.PREPARE else _short(self.step, keep)
        asked = [Ask(board, verb, step) for board in boards]
        self._waiting = {ask.board: ask for ask in asked}
        return asked

    def _went_on(self, board: str) -> list[Ask]:
        self._waiting.pop(board)
        if self._waiting and not (self.phase is Phase.SEAT and self._voted() is not None):
            return []
        return {
            Phase.PREPARE: self._all_prepared,
            Phase.APPLY: self._all_applied,
            Phase.SEAT: self._seats_voted,
            Phase.TELL: self._all_told,
        }[self.phase]()

    def _in(self, *states: str) -> list[str]:
        return [n for n, r in self.records.items() if r.state in states and n not in self.silent]

    def _all_prepared(self) -> list[Ask]:
        ready = self._in(member.PREPARED)
        left = [seat for seat in self.step.seats if seat not in self.silent]
        few = len(left) < seats.most(self.step.seats)
        if few or not self.step.policy.holds(len(self.step.members), len(ready)):
            return self._decide(Decision.REVERT)
        self.phase = Phase.APPLY
        return self._ask(ready, Verb.APPLY)

    def _all_applied(self) -> list[Ask]:
        there = self._in(member.APPLIED)
        enough = self.step.policy.holds(len(self.step.members), len(there))
        return self._decide(Decision.KEEP if enough else Decision.REVERT)

    def _decide(self, decision: Decision) -> list[Ask]:
        failed = {n: r.error for n, r in self.records.items() if r.error is not None}
        self.causes = {**failed, **self.refused, **self.silent}
        if decision is Decision.REVERT:  # certain already: nobody but us would ask for votes to keep it
            return self._tell(decision)
        self.phase = Phase.SEAT
        return self._ask(self.step.seats, Verb.VOTE, keep=True)

    def _voted(self) -> Decision | None:
        return seats.known(self._votes) or seats.counted(self._votes.values(), self.step.seats, 0)

    def _seats_voted(self) -> list[Ask]:
        decision = self._voted()
        return self._all_told() if decision is None else self._tell(decision)

    def _tell(self, decision: Decision) -> list[Ask]:
        self.decision, self.phase = decision, Phase.TELL
        untouched = self._untouched()
        told = dict.fromkeys((*self.step.members, *self.step.seats) if self._votes else self.step.members)
        asked = [name for name in told if name not in untouched]
        return self._ask(asked, Verb.DECIDE, keep=decision is Decision.KEEP) or self._all_told()

    def _untouched(self) -> set[str]:
        """Boards that refused to prepare have no part in the change."""
        return {name for name in self.refused if name not in self.records}

    def _all_told(self) -> list[Ask]:
        self._waiting = {}
        self.phase = Phase.DONE
        return []


def _short(step: FleetStep, keep: bool) -> FleetStep:
    """Later requests only name the change; the board knows the rest."""
    return FleetStep(step.id, seats=step.seats, seconds=step.seconds, keep=keep)


def first_step(
    change: str,
    boards: Iterable[str],
    config: str,
    mode: str,
    policy: Policy,
    seconds: float,
    where: tuple[str, ...] = (),
) -> FleetStep:
    """The step of preparing. `where`: its seats, else some of the boards. `seconds` until a board asks them."""
    members = tuple(sorted(boards))
    return FleetStep(change, config, mode, where or seats.chosen(members), members, policy, seconds)
