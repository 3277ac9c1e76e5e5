# SPDX-License-Identifier: Apache-2.0
"""Which boards are not where the last change of their fleet leads, by their own records. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from cm.networks.fleet.change import member
from cm.wire.messages.fleet import BoardStatus, Decision, FleetRecord
from cm.wire.messages.status import ErrorInfo

Statuses = Mapping[str, BoardStatus | ErrorInfo]


def late(status: BoardStatus, record: FleetRecord) -> bool:
    """Whether a change that has not ended here should have, by the board's own clock."""
    return record.decision is not None or status.clock.now_ns / 1e9 >= record.deadline


def difference(status: BoardStatus) -> str:
    """What is open here of the last change, or why the board is not where it should be; empty if all is well."""
    record = status.fleet
    if record is None or record.state == member.OPEN:
        return ""
    change = f"change {record.id}" + (f" of {record.caller}" if record.caller else "")
    if record.decision is None and late(status, record):
        return f"{change}: {record.state}, waits for {', '.join(record.seats)} to say what was decided"
    if not member.ended(record):
        return f"{change}: {record.state}"
    if not member.differs(record) or _place(status) == _goal(record):
        return ""
    cause = f": {record.error.message}" if record.error is not None else ""
    kept = record.decision is Decision.KEEP
    return f"{change} was {'kept, but failed here' if kept else 'taken back, but this board could not go back'}{cause}"


def stands_apart(status: BoardStatus) -> bool:
    """Whether someone should look: the board is not where the decision says, or waits for one after its time."""
    record = status.fleet
    if record is None or not difference(status):
        return False
    return member.ended(record) or (record.decision is None and late(status, record))


def _place(status: BoardStatus) -> tuple[str, str]:
    return status.status.config_name, status.status.mode


def _goal(record: FleetRecord) -> tuple[str, str]:
    kept = record.decision is Decision.KEEP
    return (record.config_name, record.mode) if kept else (record.old_config_name, record.old_mode)


def disagreeing(statuses: Statuses) -> dict[str, str]:
    """Boards that differ from what others say, each with the reason.

    First, those whose records of one change have different decisions, which can only come from a manual decision (`cm
    fleet settle`), or from seats that lost their records. Second, those that were asked to take part in a change which
    the others kept, but did not: their own records do not mention it.
    """
    records = _records(statuses)
    told: dict[str, dict[str, Decision]] = {}
    for name, record in records.items():
        if record.decision is not None:
            told.setdefault(record.id, {})[name] = record.decision
    return _left_out(statuses, records) | {
        name: f"change {change} was decided differently: {_spelt(decisions)}"
        for change, decisions in told.items()
        if len(set(decisions.values())) > 1
        for name in decisions
    }


def _records(statuses: Statuses) -> dict[str, FleetRecord]:
    there = {name: status.fleet for name, status in statuses.items() if isinstance(status, BoardStatus)}
    return {name: record for name, record in there.items() if record is not None}


def _left_out(statuses: Statuses, records: Mapping[str, FleetRecord]) -> dict[str, str]:
    kept = {record.id: record for record in records.values() if record.decision is Decision.KEEP and record.members}
    found = {}
    for record in sorted(kept.values(), key=lambda each: each.deadline):
        for name in record.members:
            status, own = statuses.get(name), records.get(name)
            later = own is None or (own.id != record.id and own.deadline < record.deadline)
            if isinstance(status, BoardStatus) and later and _place(status) != _goal(record):
                found[name] = f"it took no part in change {record.id} of {record.caller}, which the others kept"
    return found


def _spelt(decisions: Mapping[str, Decision]) -> str:
    each = {d: [n for n, said in sorted(decisions.items()) if said is d] for d in Decision}
    return "; ".join(f"{', '.join(names)}: {decision.value}" for decision, names in each.items())
