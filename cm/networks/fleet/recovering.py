# SPDX-License-Identifier: Apache-2.0
"""Abandoned changes: found by the boards' own records, decided by their seats, and told to all their members."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence

from cm.errors import InvalidRequest, NotFound
from cm.networks.fleet.change import member, seats
from cm.networks.fleet.change.asks import Ask, Verb
from cm.networks.fleet.change.coordinator import Outcome
from cm.networks.fleet.standing import Statuses, late
from cm.wire.messages.fleet import BoardStatus, Decision, FleetRecord, FleetStep
from cm.wire.messages.status import ErrorInfo

Asking = Callable[[Ask], Awaitable[FleetRecord | ErrorInfo]]
_TRIES = 5  # ballots, in case boards try at the same time


def open_changes(statuses: Statuses, change: str = "") -> dict[str, FleetRecord]:
    """One record of each change that has not ended on some board and should have, by that board's clock.

    Or the record of the named one, whether its time is over or not. Raises NotFound.
    """
    there = [status for status in statuses.values() if isinstance(status, BoardStatus)]
    known = [(status, status.fleet) for status in there if status.fleet is not None]
    if change:
        found = {record.id: record for _, record in known if record.id == change}
        if not found:
            raise NotFound(f"no board that is there has change {change} as its last")
        return found
    return {record.id: record for status, record in known if not member.ended(record) and late(status, record)}


async def decided(record: FleetRecord, ask: Asking) -> Decision | None:
    """What the seats say, or agree on; or else what any member was told. None if nobody can know."""

    async def ask_all(asks: Sequence[Ask]) -> dict[str, FleetRecord]:
        answers = await asyncio.gather(*map(ask, asks))
        pairs = zip(asks, answers, strict=True)
        return {each.board: answer for each, answer in pairs if isinstance(answer, FleetRecord)}

    found = await seats.agreed(record.id, record.seats, ask_all, _TRIES)
    if found is None:
        step = FleetStep(record.id)
        found = seats.known(await ask_all([Ask(name, Verb.SETTLE, step) for name in record.members]))
    return found


async def recovered(record: FleetRecord, ask: Asking) -> Outcome:
    """Bring a change to its end in place of its coordinator, as far as possible."""
    decision = await decided(record, ask)
    members = record.members or record.seats
    verb = Verb.SETTLE if decision is None else Verb.DECIDE
    step = FleetStep(record.id, seats=record.seats, keep=decision is Decision.KEEP)
    answers = dict(zip(members, await asyncio.gather(*(ask(Ask(n, verb, step)) for n in members)), strict=True))
    records = {n: a for n, a in answers.items() if isinstance(a, FleetRecord) and a.state != member.OPEN}
    apart = {n: _apart(a) for n, a in answers.items() if n not in records}
    silent = {n: e for n, e in apart.items() if e.code != NO_PART or decision is Decision.KEEP}
    return Outcome(record.id, decision, records, silent, record.seats, {})


NO_PART = member.NotNow.code


def _apart(answer: FleetRecord | ErrorInfo) -> ErrorInfo:
    if isinstance(answer, ErrorInfo):
        return answer
    return ErrorInfo(NO_PART, "it did not take part in the change: it is in its previous mode")


async def refuse_other(record: FleetRecord, keep: bool, ask: Asking) -> None:
    """A manual decision must not contradict one that the boards can reach without it. Raises InvalidRequest."""
    decision = await decided(record, ask)
    wanted = Decision.KEEP if keep else Decision.REVERT
    if decision is not None and decision is not wanted:
        raise InvalidRequest(
            f"change {record.id} is decided: {decision.value}, by its seats ({', '.join(record.seats)}); "
            f"`cm fleet recover {record.id}` tells it to the boards that wait"
        )


async def useful_seats(able: Sequence[str], there: Iterable[str], ask: Asking, change: str) -> tuple[str, ...]:
    """Seats for a change: members if there are enough, otherwise also other boards that answer this caller."""
    if len(able) >= seats.SEATS or len(able) < 2:
        return seats.chosen(able)
    others = [name for name in there if name not in able][: seats.NEAR]
    answers = await asyncio.gather(*(ask(Ask(name, Verb.SETTLE, FleetStep(change))) for name in others))
    willing = [name for name, answer in zip(others, answers, strict=True) if isinstance(answer, FleetRecord)]
    return seats.chosen(able, willing)
