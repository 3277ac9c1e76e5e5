# SPDX-License-Identifier: Apache-2.0
"""The one who asks: from what boards answer to what they are asked next, and to the outcome. Pure.

plan on all → prepare → apply → the decision, written down at the seat → told to all

Until the seat has the decision nobody stays in the new mode; afterwards everybody who can, does. Who hears nothing
asks the seat. So it does not matter when the coordinator ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from cm.fleet.change import member
from cm.messages.fleet import Decision, FleetRecord, FleetStep, Policy
from cm.messages.status import ErrorInfo


class Verb(str, Enum):
    """What a board is asked to do."""

    PREPARE = "prepare"
    APPLY = "apply"
    DECIDE = "decide"


@dataclass(frozen=True, slots=True)
class Ask:
    """A step for a board."""

    board: str
    verb: Verb
    step: FleetStep


class Phase(str, Enum):
    """How far a change is."""

    PREPARE = "prepare"
    APPLY = "apply"
    SEAT = "seat"  # the decision is on its way to the seat
    TELL = "tell"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a change ended.

    `decision` is None where nobody knows: the seat went away with it. `records` are the boards' own words, `silent`
    why nothing is known of the others.
    """

    id: str
    decision: Decision | None
    records: Mapping[str, FleetRecord]
    silent: Mapping[str, ErrorInfo]
    seat: str
    causes: Mapping[str, ErrorInfo]  # what had gone wrong, and where, when it was decided

    @property
    def differing(self) -> dict[str, str]:
        """Boards that are not where the decision says, or of which nobody knows, each with the reason."""
        found = {name: _reason(record) for name, record in self.records.items() if member.differs(record)}
        return found | {name: error.message for name, error in self.silent.items()}


def _reason(record: FleetRecord) -> str:
    if record.decision is None:
        return f"it is {record.state} and waits for the decision, which it asks {record.seat} for"
    return record.error.message if record.error else f"it is {record.state}"


@dataclass
class Coordinator:
    """One change. Give it answers and silences; what it returns is to be asked."""

    step: FleetStep  # of preparing; its members are asked, its seat is one of them
    phase: Phase = Phase.PREPARE
    decision: Decision | None = None
    records: dict[str, FleetRecord] = field(default_factory=dict)
    silent: dict[str, ErrorInfo] = field(default_factory=dict)
    refused: dict[str, ErrorInfo] = field(default_factory=dict)
    causes: dict[str, ErrorInfo] = field(default_factory=dict)
    _waiting: set[str] = field(default_factory=set)
    _keep_was_sent: bool = False

    def start(self) -> list[Ask]:
        """All are asked to prepare."""
        return self._ask(self.step.members, Verb.PREPARE)

    def answered(self, board: str, answer: FleetRecord | ErrorInfo) -> list[Ask]:
        """A board's answer; one that is late, or comes twice, changes nothing."""
        if board not in self._waiting:
            return []
        if isinstance(answer, ErrorInfo):
            self.refused[board] = answer
        else:
            self.records[board] = answer
            self.silent.pop(board, None)
        return self._went_on(board)

    def heard_nothing(self, board: str, reason: ErrorInfo) -> list[Ask]:
        """It vanished, or the time for its answer is over."""
        if board not in self._waiting:
            return []
        self.silent[board] = reason
        return self._went_on(board)

    @property
    def waiting(self) -> frozenset[str]:
        """Of whom an answer is awaited."""
        return frozenset(self._waiting)

    def outcome(self) -> Outcome:
        """As far as it is known now."""
        silent = {**self.silent, **{n: e for n, e in self.refused.items() if n not in self.records}}
        if self.decision is Decision.REVERT:  # who refused to prepare did nothing, and is where it was
            silent = {n: e for n, e in silent.items() if n not in self.refused or n in self.silent}
        known = {n: r for n, r in self.records.items() if n not in silent}
        return Outcome(self.step.id, self.decision, known, silent, self.step.seat, dict(self.causes))

    # ---- the steps ------------------------------------------------------------------------

    def _ask(self, boards: Iterable[str], verb: Verb, keep: bool = False) -> list[Ask]:
        step = self.step if verb is Verb.PREPARE else _short(self.step, keep)
        asked = [Ask(board, verb, step) for board in boards]
        self._waiting = {ask.board for ask in asked}
        return asked

    def _went_on(self, board: str) -> list[Ask]:
        self._waiting.discard(board)
        if self._waiting:
            return []
        return {
            Phase.PREPARE: self._all_prepared,
            Phase.APPLY: self._all_applied,
            Phase.SEAT: self._seat_answered,
            Phase.TELL: self._all_told,
        }[self.phase]()

    def _in(self, *states: str) -> list[str]:
        return [n for n, r in self.records.items() if r.state in states and n not in self.silent]

    def _all_prepared(self) -> list[Ask]:
        ready = self._in(member.PREPARED)
        if self.step.seat in self.silent or not self.step.policy.holds(len(self.step.members), len(ready)):
            return self._decide(Decision.REVERT)
        self.phase = Phase.APPLY
        return self._ask(ready, Verb.APPLY)

    def _all_applied(self) -> list[Ask]:
        there = self._in(member.APPLIED)
        enough = self.step.policy.holds(len(self.step.members), len(there))
        return self._decide(Decision.KEEP if enough else Decision.REVERT)

    def _decide(self, decision: Decision) -> list[Ask]:
        self.phase = Phase.SEAT
        self._keep_was_sent = decision is Decision.KEEP
        failed = {n: r.error for n, r in self.records.items() if r.error is not None}
        self.causes = {**failed, **self.refused, **self.silent}
        return self._ask([self.step.seat], Verb.DECIDE, keep=self._keep_was_sent)

    def _seat_answered(self) -> list[Ask]:
        seat = self.step.seat
        record = self.records.get(seat)
        if seat not in self.silent and record is not None and record.decision is not None:
            self.decision = record.decision
        elif not self._keep_was_sent:  # nobody can have written "keep": the seat will say so too, when it is back
            self.decision = Decision.REVERT
        if self.decision is None:
            self.phase = Phase.DONE
            return []
        self.phase = Phase.TELL
        others = [name for name in self.step.members if name != seat and name not in self._untouched()]
        return self._ask(others, Verb.DECIDE, keep=self.decision is Decision.KEEP) or self._all_told()

    def _untouched(self) -> set[str]:
        """Who refused to prepare has no part in it."""
        return {name for name in self.refused if name not in self.records}

    def _all_told(self) -> list[Ask]:
        self.phase = Phase.DONE
        return []


def _short(step: FleetStep, keep: bool) -> FleetStep:
    """What is asked for later names the change; the board has the rest."""
    return FleetStep(step.id, seat=step.seat, seconds=step.seconds, keep=keep)


def first_step(
    change: str,
    boards: Iterable[str],
    config: str,
    mode: str,
    policy: Policy,
    seconds: float,
    seat: str = "",
) -> FleetStep:
    """The step of preparing; without a seat it is the first board by name. `seconds` until a board asks the seat."""
    members = tuple(sorted(boards))
    return FleetStep(change, config, mode, seat or members[0], members, policy, seconds)
