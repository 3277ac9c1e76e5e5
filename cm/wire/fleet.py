# SPDX-License-Identifier: Apache-2.0
"""Messages of fleets ↔ frozen data. A bridge changes no byte of a manager's messages: it appends fields."""

from __future__ import annotations

from typing import Any, TypeVar

from google.protobuf.message import DecodeError, Message

from cm.errors import InvalidRequest
from cm.wire import bodies
from cm.wire import cm_pb2 as pb
from cm.wire.messages import fleet as fl
from cm.wire.messages.status import ErrorInfo

_M = TypeVar("_M", bound=Message)


def parsed(kind: type[_M], data: bytes) -> _M:
    """A message of this kind. Raises InvalidRequest."""
    try:
        return kind.FromString(data)
    except DecodeError as problem:
        raise InvalidRequest(f"the payload is not a valid {kind.__name__} message ({problem})") from problem


def encode_step(step: fl.FleetStep) -> bytes:
    """As it is the payload of a command under ``do/``."""
    plain = {name: getattr(step, name) for name in fl.FleetStep.__slots__}
    return pb.FleetStep(**plain).SerializeToString()


def decode_step(data: bytes) -> fl.FleetStep:
    """Raises InvalidRequest for what is not a step, or has no id."""
    m = parsed(pb.FleetStep, data)
    if not m.id or not m.id.isascii() or not m.id.isprintable() or len(m.id) > 64 or "/" in m.id:
        raise InvalidRequest(f"a change of a fleet has an id of 1 to 64 printable characters without /, not {m.id!r}")
    return fl.FleetStep(m.id, m.config_name, m.mode, m.generation)


def policy(said: fl.Policy | str) -> fl.Policy:
    """A policy by its name. Raises InvalidRequest."""
    try:
        return fl.Policy.of(said)
    except ValueError as unknown:
        raise InvalidRequest(str(unknown)) from None


def _state_to_pb(state: fl.FleetState) -> pb.FleetState:
    plain = {name: getattr(state, name) for name in fl.FleetState.__slots__ if name != "error"}
    message = pb.FleetState(**plain)
    if state.error is not None:
        message.error.CopyFrom(bodies.error_to_pb(state.error))
    return message


def _state_from_pb(m: pb.FleetState) -> fl.FleetState:
    error = bodies.error_from_pb(m.error) if m.HasField("error") else None
    return fl.FleetState(**{n: getattr(m, n) for n in fl.FleetState.__slots__ if n != "error"}, error=error)


def extras(labels: tuple[str, ...], clock: fl.ClockSync, state: fl.FleetState) -> bytes:
    """What is appended to a serialised Status: protobuf reads messages that follow each other as one."""
    return pb.Status(labels=labels, clock=_clock_to_pb(clock), fleet=_state_to_pb(state)).SerializeToString()


def board_status(data: bytes) -> fl.BoardStatus:
    """A Status with what a bridge added. Raises InvalidRequest."""
    message = parsed(pb.Status, data)
    state = _state_from_pb(message.fleet) if message.HasField("fleet") else None
    return fl.BoardStatus(bodies.status_from_pb(message), tuple(message.labels), _clock_from_pb(message.clock), state)


def body(reply: bytes) -> tuple[str, bytes] | ErrorInfo:
    """The content of a Reply: the name of its message and its bytes, or the error. Raises InvalidRequest."""
    message: Any = parsed(pb.Reply, reply)
    if not message.ok:
        return bodies.error_from_pb(message.error)
    field = message.WhichOneof("body")
    if not field:
        return "Reply", reply
    found = getattr(message, field)
    return found.DESCRIPTOR.name, found.SerializeToString()


def each_register(data: bytes) -> list[tuple[str, bytes]]:
    """RegValues of several registers → those of each, with its name."""
    message = parsed(pb.RegValues, data)
    return [
        (
            value.name,
            pb.RegValues(
                values=[value],
                config_name=message.config_name,
                mode=message.mode,
                generation=message.generation,
            ).SerializeToString(),
        )
        for value in message.values
    ]


def irq_name(data: bytes) -> str:
    """Of an Irq message."""
    return parsed(pb.Irq, data).name


def glance(status: bytes) -> tuple[tuple[str, ...], tuple[str, str] | None]:
    """Of a Status: the streams that can be read, and configuration and mode, or None while they change."""
    message = parsed(pb.Status, status)
    streams = tuple(stream.name for stream in message.streams if stream.direction == "s2mm")
    return streams, None if message.fpga_busy else (message.config_name, message.mode)


def _clock_to_pb(clock: fl.ClockSync) -> pb.ClockSync:
    return pb.ClockSync(
        source=clock.source,
        synchronised=clock.synchronised,
        error_ns=clock.error_ns,
        reference=clock.reference,
        now_ns=clock.now_ns,
    )


def _clock_from_pb(m: pb.ClockSync) -> fl.ClockSync:
    return fl.ClockSync(m.source, m.synchronised, m.error_ns, m.reference, m.now_ns)


def encode_fetch(fetch: fl.FetchBundle) -> bytes:
    """As it is the payload of ``do/bundle``."""
    message = pb.FetchBundle(
        sha256=fetch.sha256, length=fetch.length, parts=fetch.parts, part_length=fetch.part_length, name=fetch.name
    )
    return message.SerializeToString()


def decode_fetch(data: bytes) -> fl.FetchBundle:
    """The inverse of `encode_fetch`. Raises InvalidRequest."""
    m = parsed(pb.FetchBundle, data)
    wanted = -(-m.length // m.part_length) if m.part_length else 0
    hashes = (m.sha256, *m.parts)
    if not m.length or len(m.parts) != wanted or not all(_is_sha256(text) for text in hashes):
        raise InvalidRequest(
            f"a bundle of {m.length} bytes in parts of {m.part_length} has {wanted} parts, each with its sha256 "
            f"(64 hexadecimal digits); {len(m.parts)} are named"
        )
    return fl.FetchBundle(m.sha256, m.length, tuple(m.parts), m.part_length, m.name)


def _is_sha256(text: str) -> bool:
    return len(text) == 64 and all(c in "0123456789abcdef" for c in text)


def _bundle_to_pb(b: fl.BundleState) -> pb.BundleState:
    message = pb.BundleState(sha256=b.sha256, length=b.length, have=b.have, config_name=b.config_name, signer=b.signer)
    if b.error is not None:
        message.error.CopyFrom(bodies.error_to_pb(b.error))
    return message


def _bundle_from_pb(m: pb.BundleState) -> fl.BundleState:
    error = bodies.error_from_pb(m.error) if m.HasField("error") else None
    return fl.BundleState(m.sha256, m.length, m.have, m.config_name, m.signer, error)


def encode_answer(body: fl.FleetState | fl.BundleState | ErrorInfo) -> bytes:
    """A Reply of the bridge itself, in the form of a manager's."""
    if isinstance(body, ErrorInfo):
        message = pb.Reply(ok=False, error=bodies.error_to_pb(body))
    elif isinstance(body, fl.FleetState):
        message = pb.Reply(ok=True, fleet=_state_to_pb(body))
    else:
        message = pb.Reply(ok=True, bundle=_bundle_to_pb(body))
    return message.SerializeToString()


def decode_answer(data: bytes) -> fl.FleetState | fl.BundleState | ErrorInfo:
    """The inverse of `encode_answer`. Raises InvalidRequest for a Reply with another body."""
    reply: Any = parsed(pb.Reply, data)
    if not reply.ok:
        return bodies.error_from_pb(reply.error)
    if reply.HasField("fleet"):
        return _state_from_pb(reply.fleet)
    if reply.HasField("bundle"):
        return _bundle_from_pb(reply.bundle)
    raise InvalidRequest(f"the bridge answered with {reply.WhichOneof('body')}, not with a state or a bundle")
