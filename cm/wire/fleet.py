# SPDX-License-Identifier: Apache-2.0
"""Messages of fleets ↔ frozen data. A bridge changes no byte of a manager's messages: it appends fields."""

from __future__ import annotations

from typing import Any

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire import protobuf_messages
from cm.wire.encode import parsed
from cm.wire.messages import fleet as fl
from cm.wire.messages.status import ErrorInfo, RegValues

_STEP = protobuf_messages.Twin(fl.FleetStep, pb.FleetStep)
_STATE = protobuf_messages.Twin(fl.FleetState, pb.FleetState, error=protobuf_messages.ERROR)
_FETCH = protobuf_messages.Twin(fl.FetchBundle, pb.FetchBundle)
_BUNDLE = protobuf_messages.Twin(fl.BundleState, pb.BundleState, error=protobuf_messages.ERROR)


def encode_step(step: fl.FleetStep) -> bytes:
    """As it is the payload of a command under ``do/``."""
    return _STEP.to_pb(step).SerializeToString()


def decode_step(data: bytes) -> fl.FleetStep:
    """Raises InvalidRequest for what is not a step, or has no id."""
    m = parsed(pb.FleetStep, data)
    if not m.id or not m.id.isascii() or not m.id.isprintable() or len(m.id) > 64 or "/" in m.id:
        raise InvalidRequest(f"a change of a fleet has an id of 1 to 64 printable characters without /, not {m.id!r}")
    return _STEP.from_pb(m)


def policy(said: fl.Policy | str) -> fl.Policy:
    """A policy by its name. Raises InvalidRequest."""
    try:
        return fl.Policy.of(said)
    except ValueError as unknown:
        raise InvalidRequest(str(unknown)) from None


def extras(labels: tuple[str, ...], state: fl.FleetState) -> bytes:
    """What is appended to a serialised Status: protobuf reads messages that follow each other as one."""
    return pb.Status(labels=labels, fleet=_STATE.to_pb(state)).SerializeToString()


def board_status(data: bytes) -> fl.BoardStatus:
    """A Status with what a bridge added. Raises InvalidRequest."""
    message = parsed(pb.Status, data)
    state = _STATE.from_pb(message.fleet) if message.HasField("fleet") else None
    return fl.BoardStatus(protobuf_messages.STATUS.from_pb(message), tuple(message.labels), state)


def body(reply: bytes) -> tuple[str, bytes] | ErrorInfo:
    """The content of a Reply: the name of its message and its bytes, or the error. Raises InvalidRequest."""
    message: Any = parsed(pb.Reply, reply)
    if not message.ok:
        return protobuf_messages.ERROR.from_pb(message.error)
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


def glance(status: bytes) -> tuple[tuple[str, ...], tuple[tuple[str, str], int, int] | None]:
    """Of a Status: the streams that can be read; configuration and mode, the manager's start, the last change's end.

    The latter three are None while it is busy; times in ns, by CLOCK_REALTIME.
    """
    message = parsed(pb.Status, status)
    streams = tuple(stream.name for stream in message.streams if stream.direction == "s2mm")
    if message.fpga_busy:
        return streams, None
    ended = message.last_change_ns + message.realtime_offset_ns
    return streams, ((message.config_name, message.mode), message.started_ns, ended)


def encode_fetch(fetch: fl.FetchBundle) -> bytes:
    """As it is the payload of ``do/bundle``."""
    return _FETCH.to_pb(fetch).SerializeToString()


def decode_fetch(data: bytes) -> fl.FetchBundle:
    """The inverse of `encode_fetch`. Raises InvalidRequest."""
    m = parsed(pb.FetchBundle, data)
    if not m.length or len(m.sha256) != 64 or not set(m.sha256) <= set("0123456789abcdef"):
        raise InvalidRequest(f"a bundle has a length, not {m.length}, and a sha256 of 64 hexadecimal digits")
    return _FETCH.from_pb(m)


def encode_answer(body: fl.FleetState | fl.BundleState | ErrorInfo) -> bytes:
    """A Reply of the bridge itself, in the form of a manager's."""
    if isinstance(body, ErrorInfo):
        message = pb.Reply(ok=False, error=protobuf_messages.ERROR.to_pb(body))
    elif isinstance(body, fl.FleetState):
        message = pb.Reply(ok=True, fleet=_STATE.to_pb(body))
    else:
        message = pb.Reply(ok=True, bundle=_BUNDLE.to_pb(body))
    return message.SerializeToString()


def decode_answer(data: bytes) -> fl.FleetState | fl.BundleState | RegValues | ErrorInfo:
    """Of a Reply of the bridge, or of a manager about registers. Raises InvalidRequest for one with another body."""
    reply: Any = parsed(pb.Reply, data)
    if not reply.ok:
        return protobuf_messages.ERROR.from_pb(reply.error)
    if reply.HasField("fleet"):
        return _STATE.from_pb(reply.fleet)
    if reply.HasField("bundle"):
        return _BUNDLE.from_pb(reply.bundle)
    if reply.HasField("registers"):
        return protobuf_messages.registers_from_pb(reply.registers)
    raise InvalidRequest(
        f"the bridge answered with {reply.WhichOneof('body')}, not with a state, a bundle or registers"
    )
