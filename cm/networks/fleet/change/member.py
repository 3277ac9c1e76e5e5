# SPDX-License-Identifier: Apache-2.0
"""A board's part in a change of many: a table of states, and what is to be done in each. Pure.

A record is written before the work that it describes is done. So after any crash it tells what may have happened, and
what is to be done next: `todo` says so from the record alone.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

from cm.errors import CmError
from cm.wire.messages.fleet import Decision, FleetRecord
from cm.wire.messages.status import ErrorInfo

OPEN = "open"  # at a seat that takes no part in the change itself: it holds its vote, and the decision
PREPARED, APPLYING, APPLIED, FAILED = "prepared", "applying", "applied", "failed"
REVERTING, NEW, OLD, STUCK = "reverting", "new", "old", "stuck"


class Event(str, Enum):
    """What happens to a record."""

    APPLY = "apply"  # the coordinator asks for it
    LOADED = "loaded"  # the board is where the record wanted it
    LOAD_FAILED = "load_failed"
    LOST = "lost"  # the result of the load is unknown, and the board is where it was


class NotNow(CmError):
    """A step that the board's record does not allow."""

    code = "fleet_state"


# (state, event) → state; other combinations cannot happen
_NEXT = {
    (PREPARED, Event.APPLY): APPLYING,
    (APPLYING, Event.APPLY): APPLYING,
    (APPLIED, Event.APPLY): APPLIED,
    (FAILED, Event.APPLY): FAILED,
    (APPLYING, Event.LOADED): APPLIED,
    (APPLYING, Event.LOAD_FAILED): FAILED,
    (APPLYING, Event.LOST): PREPARED,
    (REVERTING, Event.LOADED): OLD,
    (REVERTING, Event.LOAD_FAILED): STUCK,
    (REVERTING, Event.LOST): REVERTING,
}

# (state, decision) → state, once the decision is known
_DECIDED = {
    (PREPARED, Decision.KEEP): APPLYING,  # a laggard: the fleet changed without it
    (APPLIED, Decision.KEEP): NEW,
    (PREPARED, Decision.REVERT): OLD,
    (APPLIED, Decision.REVERT): REVERTING,
    (FAILED, Decision.REVERT): REVERTING,  # nothing to load if the manager went back by itself
}
_ENDED = {(NEW, Decision.KEEP), (FAILED, Decision.KEEP), (OLD, Decision.REVERT), (STUCK, Decision.REVERT)}


class Todo(str, Enum):
    """What the owner of the record does next."""

    NOTHING = "nothing"
    LOAD_NEW = "load_new"
    LOAD_OLD = "load_old"
    ASK_SEATS = "ask_seats"


def after(record: FleetRecord, event: Event, error: ErrorInfo | None = None, seconds: float = 0.0) -> FleetRecord:
    """The record after an event. Raises NotNow."""
    state = _NEXT.get((record.state, event))
    if state is None:
        raise NotNow(f"change {record.id} is {record.state} on this board: there is nothing to {event.value}")
    changed = replace(record, state=state, error=error or record.error, seconds=seconds or record.seconds)
    return _normal(changed)


def decided(record: FleetRecord, decision: Decision) -> FleetRecord:
    """The record once the decision is known; the first that was written down counts."""
    return _normal(replace(record, decision=record.decision or decision))


def _normal(record: FleetRecord) -> FleetRecord:
    if record.decision is None:
        return record
    return replace(record, state=_DECIDED.get((record.state, record.decision), record.state))


def ended(record: FleetRecord) -> bool:
    """Whether nothing remains to be done, so that the board is free for another change."""
    return record.decision is not None and (record.state == OPEN or (record.state, record.decision) in _ENDED)


def differs(record: FleetRecord) -> bool:
    """Whether the board is not where the decision says, or may not be."""
    if record.decision is None:
        return True
    return record.state != (NEW if record.decision is Decision.KEEP else OLD)


def todo(record: FleetRecord, now: float) -> Todo:
    """What comes next; `now` in seconds of CLOCK_REALTIME."""
    if record.state == APPLYING:
        return Todo.LOAD_NEW
    if record.state == REVERTING:
        return Todo.LOAD_OLD
    if record.decision is None and now >= record.deadline:
        return Todo.ASK_SEATS
    return Todo.NOTHING
