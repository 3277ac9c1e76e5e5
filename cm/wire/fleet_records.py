# SPDX-License-Identifier: Apache-2.0
"""Steps and records of changes of many boards ↔ frozen data."""

from __future__ import annotations

from typing import TypeVar

from google.protobuf.message import DecodeError, Message

from cm.errors import InvalidRequest
from cm.wire import bodies
from cm.wire import cm_pb2 as pb
from cm.wire.messages import fleet as fl

_M = TypeVar("_M", bound=Message)
LONGEST = 30 * 86400  # seconds
BALLOTS = 1 << 32  # far more than tries that one change can need


def parsed(kind: type[_M], data: bytes) -> _M:
    """A message of this kind. Raises InvalidRequest."""
    try:
        return kind.FromString(data)
    except DecodeError as problem:
        raise InvalidRequest(f"the payload is not a valid {kind.__name__} message ({problem})") from problem


def encode_step(step: fl.FleetStep) -> bytes:
    """As it is the payload of a command under ``do/``."""
    message = pb.FleetStep(
        id=step.id,
        config_name=step.config_name,
        mode=step.mode,
        seat=step.seats[0] if step.seats else "",
        seats=step.seats,
        ballot=step.ballot,
        members=step.members,
        policy=step.policy.value,
        seconds=step.seconds,
        keep=step.keep,
    )
    return message.SerializeToString()


def decode_step(data: bytes) -> fl.FleetStep:
    """Raises InvalidRequest for what is not a step, has no id, or has a ballot that leaves no room for another."""
    m = parsed(pb.FleetStep, data)
    if not m.id or not m.id.isascii() or not m.id.isprintable() or len(m.id) > 64 or "/" in m.id:
        raise InvalidRequest(f"a change of a fleet has an id of 1 to 64 printable characters without /, not {m.id!r}")
    if not 0 <= m.seconds <= LONGEST:  # also refuses NaN
        raise InvalidRequest(
            f"change {m.id}: 0 to {LONGEST} seconds until boards ask for the decision, not {m.seconds}"
        )
    if m.ballot >= BALLOTS:
        raise InvalidRequest(f"ballot {m.ballot} of change {m.id}: they go up one by one, to below {BALLOTS}")
    where, members, rule = _seats(m), tuple(m.members), policy(m.policy or "all")
    return fl.FleetStep(m.id, m.config_name, m.mode, where, members, rule, m.seconds, m.keep, m.ballot)


def _seats(m: pb.FleetStep | pb.FleetRecord) -> tuple[str, ...]:
    return tuple(m.seats) or ((m.seat,) if m.seat else ())


def policy(said: fl.Policy | str) -> fl.Policy:
    """A policy by its name. Raises InvalidRequest."""
    try:
        return fl.Policy.of(said)
    except ValueError as unknown:
        raise InvalidRequest(str(unknown)) from None


def record_to_pb(r: fl.FleetRecord) -> pb.FleetRecord:
    """A record as a message."""
    message = pb.FleetRecord(
        id=r.id,
        state=r.state,
        config_name=r.config_name,
        mode=r.mode,
        old_config_name=r.old_config_name,
        old_mode=r.old_mode,
        seat=r.seats[0] if r.seats else "",
        seats=r.seats,
        promised=r.promised,
        vote=r.vote.value if r.vote else "",
        vote_ballot=r.vote_ballot,
        decision=r.decision.value if r.decision else "",
        plan_seconds=r.plan_seconds,
        plan_bytes=r.plan_bytes,
        seconds=r.seconds,
        caller=r.caller,
        members=r.members,
        policy=r.policy.value,
        deadline=r.deadline,
    )
    if r.error is not None:
        message.error.CopyFrom(bodies.error_to_pb(r.error))
    return message


def record_from_pb(m: pb.FleetRecord) -> fl.FleetRecord:
    """A message as a record."""
    return fl.FleetRecord(
        id=m.id,
        state=m.state,
        config_name=m.config_name,
        mode=m.mode,
        old_config_name=m.old_config_name,
        old_mode=m.old_mode,
        seats=_seats(m),
        decision=_decision(m.decision),
        error=bodies.error_from_pb(m.error) if m.HasField("error") else None,
        plan_seconds=m.plan_seconds,
        plan_bytes=m.plan_bytes,
        seconds=m.seconds,
        caller=m.caller,
        members=tuple(m.members),
        policy=policy(m.policy or "all"),
        deadline=m.deadline,
        promised=m.promised,
        vote=_decision(m.vote),
        vote_ballot=m.vote_ballot,
    )


def _decision(text: str) -> fl.Decision | None:
    try:
        return fl.Decision(text) if text else None
    except ValueError:
        raise InvalidRequest(f"decision {text!r}: keep or revert is wanted, or nothing") from None


def encode_record(record: fl.FleetRecord) -> bytes:
    """As it lies on a board's disk."""
    return record_to_pb(record).SerializeToString()


def decode_record(data: bytes) -> fl.FleetRecord:
    """Raises InvalidRequest."""
    return record_from_pb(parsed(pb.FleetRecord, data))
