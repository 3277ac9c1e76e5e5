# SPDX-License-Identifier: Apache-2.0
"""The decision of a change, agreed on by its seats: Paxos for one value (Lamport, "Paxos Made Simple", 2001). Pure.

Seats vote in ballots, and record votes and promises before they answer. What a majority has voted for in one ballot
is the decision, and nothing else can become it. Ballot 0 belongs to the coordinator, which alone may propose to keep
the new mode. A board that waits for it in vain takes a higher ballot: a majority of the seats promise to accept no
vote in a lower one, and say what they last voted for; that is proposed again, since it may be the decision already,
or else to go back. So the decision survives its maker, and any minority of the seats.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from cm.networks.fleet.change.asks import Ask, AskAll, Verb
from cm.networks.fleet.change.member import OPEN, NotNow, decided
from cm.wire.messages.fleet import Decision, FleetRecord, FleetStep

SEATS = 3  # one of them may be gone for good
NEAR = 8  # boards that are asked at a time whether they know the decision, if too few seats answer


def chosen(members: Iterable[str], others: Iterable[str] = ()) -> tuple[str, ...]:
    """Seats of a change: three of its members, or other boards too if those are two.

    One if there are not three boards, because two would be worse: both would have to answer. One also for a change of a
    single board, which nobody else waits for.
    """
    own = list(dict.fromkeys(members))
    able = list(dict.fromkeys((*own, *others))) if len(own) > 1 else own
    return tuple(able[:SEATS]) if len(able) >= SEATS else tuple(able[:1])


def most(seats: tuple[str, ...]) -> int:
    """How many of them have to agree."""
    return len(seats) // 2 + 1


# ---- at a seat ------------------------------------------------------------------------------


def promised(record: FleetRecord | None, change: str, ballot: int) -> FleetRecord:
    """The seat's record when it is asked to promise; ballot 0 asks only what it knows. Raises NotNow.

    Each ballot is promised once: the same number is refused the next time, whoever asks.
    """
    record = record or FleetRecord(change, OPEN)
    if ballot == 0 or record.decision is not None:
        return record
    if ballot <= record.promised:
        raise NotNow(f"change {change}: ballot {record.promised} is promised here already")
    return replace(record, promised=ballot)


def voted(record: FleetRecord | None, step: FleetStep) -> FleetRecord:
    """The seat's record once it has voted as the step wants. Raises NotNow if a higher ballot is promised."""
    record = record or FleetRecord(step.id, OPEN, seats=step.seats)
    if record.decision is not None:
        return record
    if step.ballot < record.promised:
        raise NotNow(f"change {step.id}: ballot {record.promised} is promised here, {step.ballot} comes too late")
    vote = Decision.KEEP if step.keep else Decision.REVERT
    return replace(record, promised=step.ballot, vote=vote, vote_ballot=step.ballot)


# ---- who asks them --------------------------------------------------------------------------


def known(answers: Mapping[str, FleetRecord]) -> Decision | None:
    """The decision, if one of them was told it."""
    return next((record.decision for record in answers.values() if record.decision is not None), None)


def counted(votes: Iterable[FleetRecord], seats: tuple[str, ...], ballot: int) -> Decision | None:
    """What most seats have voted for in a ballot."""
    cast = [record.vote for record in votes if record.vote is not None and record.vote_ballot == ballot]
    return next((vote for vote in cast if cast.count(vote) >= most(seats)), None)


async def agreed(change: str, seats: tuple[str, ...], ask: AskAll, tries: int = 1) -> Decision | None:
    """Bring the seats to a decision. None if too few answer, or another board interfered with each try."""
    for _ in range(tries):
        answers = await ask(_to_each(seats, Verb.SETTLE, FleetStep(change, seats=seats)))
        if known(answers) is not None or len(answers) < most(seats):
            return known(answers)
        found = await _ballot(change, seats, ask, 1 + max(record.promised for record in answers.values()))
        if found is not None:
            return found
    return None


async def _ballot(change: str, seats: tuple[str, ...], ask: AskAll, ballot: int) -> Decision | None:
    answers = await ask(_to_each(seats, Verb.SETTLE, FleetStep(change, seats=seats, ballot=ballot)))
    if known(answers) is not None or len(answers) < most(seats):
        return known(answers)
    keep = last_vote(answers.values()) is Decision.KEEP
    answers = await ask(_to_each(seats, Verb.VOTE, FleetStep(change, seats=seats, keep=keep, ballot=ballot)))
    return known(answers) or counted(answers.values(), seats, ballot)


def last_vote(records: Iterable[FleetRecord]) -> Decision | None:
    """The vote in the highest ballot that any of them voted in: it may be the decision already."""
    cast = [(record.vote_ballot, record.vote) for record in records if record.vote is not None]
    return max(cast, key=lambda pair: pair[0])[1] if cast else None


def who_may_know(record: FleetRecord, board: str) -> list[Ask]:
    """A few of the other members, those after this one by name: what one knows so reaches all, whoever is away."""
    names = sorted({*record.members} - {*record.seats} | {board})
    after = names[names.index(board) + 1 :] + names[: names.index(board)]
    return _to_each(after[:NEAR], Verb.SETTLE, FleetStep(record.id))


def _to_each(boards: Iterable[str], verb: Verb, step: FleetStep) -> list[Ask]:
    return [Ask(board, verb, step) for board in boards]


def told(record: FleetRecord | None, step: FleetStep, name: str) -> FleetRecord:
    """A board's record once it is told the decision. Raises NotNow if it has no part in the change."""
    if record is None:
        if name not in step.seats:
            raise NotNow(f"{name} took no part in change {step.id}")
        record = FleetRecord(step.id, OPEN, seats=step.seats)
    return decided(record, Decision.KEEP if step.keep else Decision.REVERT)
