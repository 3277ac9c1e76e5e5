# SPDX-License-Identifier: Apache-2.0
"""Messages of fleets ↔ frozen data. A bridge changes no byte of a manager's messages: it appends fields."""

from __future__ import annotations

from typing import Any

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire.encode import decode_reply, decoded, encode_reply, parsed
from cm.wire.messages import fleet as fl
from cm.wire.messages.status import ErrorInfo, RegValues, Reply
from cm.wire.protobuf_messages import ERROR, STATUS, twin

_STATE = twin(fl.FleetState)


def decode_step(data: bytes) -> fl.FleetStep:
    """Raises InvalidRequest for what is not a step, or has no id."""
    step = decoded(fl.FleetStep, data)
    name = step.id
    if not name or not name.isascii() or not name.isprintable() or len(name) > 64 or "/" in name:
        raise InvalidRequest(f"a change of a fleet has an id of 1 to 64 printable characters without /, not {name!r}")
    return step


def extras(labels: tuple[str, ...], state: fl.FleetState) -> bytes:
    """What is appended to a serialised Status: protobuf reads messages that follow each other as one."""
    return pb.Status(labels=labels, fleet=_STATE.to_pb(state)).SerializeToString()


def board_status(data: bytes) -> fl.BoardStatus:
    """A Status with what a bridge added. Raises InvalidRequest."""
    message = parsed(pb.Status, data)
    state = _STATE.from_pb(message.fleet) if message.HasField("fleet") else None
    return fl.BoardStatus(STATUS.from_pb(message), tuple(message.labels), state)


def body(reply: bytes) -> tuple[str, bytes] | ErrorInfo:
    """The content of a Reply: the name of its message and its bytes, or the error. Raises InvalidRequest."""
    message: Any = parsed(pb.Reply, reply)
    if not message.ok:
        return ERROR.from_pb(message.error)
    field = message.WhichOneof("body")
    if not field:
        return "Reply", reply
    found = getattr(message, field)
    return found.DESCRIPTOR.name, found.SerializeToString()


def each_register(data: bytes) -> list[tuple[str, bytes]]:
    """RegValues of several registers → those of each, with its name."""
    message = parsed(pb.RegValues, data)
    each = [(value.name, pb.RegValues(values=[value]).SerializeToString()) for value in message.values]
    message.ClearField("values")
    beside = message.SerializeToString()
    return [(name, value + beside) for name, value in each]


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


def decode_fetch(data: bytes) -> fl.FetchBundle:
    """What is asked for by ``do/bundle``. Raises InvalidRequest."""
    fetch = decoded(fl.FetchBundle, data)
    if not fetch.length or len(fetch.sha256) != 64 or not set(fetch.sha256) <= set("0123456789abcdef"):
        raise InvalidRequest(f"a bundle has a length, not {fetch.length}, and a sha256 of 64 hexadecimal digits")
    return fetch


def encode_answer(body: fl.FleetState | fl.BundleState | ErrorInfo) -> bytes:
    """A Reply of the bridge itself, in the form of a manager's."""
    reply = Reply(error=body) if isinstance(body, ErrorInfo) else Reply(body)
    return bytes(encode_reply(b"", reply)[1])


def decode_answer(data: bytes) -> fl.FleetState | fl.BundleState | RegValues | ErrorInfo:
    """Of a Reply of the bridge, or of a manager about registers. Raises InvalidRequest for one with another body."""
    reply = decode_reply([b"", data])
    if reply.error is not None:
        return reply.error
    if isinstance(reply.body, (fl.FleetState, fl.BundleState, RegValues)):
        return reply.body
    raise InvalidRequest(
        f"the bridge answered with {type(reply.body).__name__}, not with a state, a bundle or registers"
    )
