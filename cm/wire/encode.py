# SPDX-License-Identifier: Apache-2.0
"""Frozen requests → frames (a client's side), replies and events ↔ frames (both sides)."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeVar

from google.protobuf.message import DecodeError, Message

from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.wire import cm_pb2 as pb
from cm.wire import protobuf_messages, topics
from cm.wire.messages import requests as rq
from cm.wire.messages import status as st
from cm.wire.protobuf_messages import CODECS, kind_of, message_of
from cm.wire.request_table import BY_KIND

Frame = bytes | memoryview
_D = TypeVar("_D")
_M = TypeVar("_M", bound=Message)
_REPEATED = 16  # writes of a request that is likely to come again


def parsed(kind: type[_M], data: bytes) -> _M:
    """A message of this kind. Raises InvalidRequest."""
    try:
        return kind.FromString(data)
    except DecodeError as problem:
        raise InvalidRequest(f"the payload is not a valid {kind.__name__} message ({problem})") from problem


def encoded(data: Any) -> bytes:
    """A message by itself, of any class of `cm.wire.messages.status`."""
    return bytes(CODECS[type(data)].to_pb(data).SerializeToString())


def decoded(kind: type[_D], data: bytes) -> _D:
    """The inverse of `encoded`. Raises InvalidRequest."""
    read: _D = CODECS[kind].from_pb(parsed(message_of(kind), data))
    return read


def encode_request(request: rq.Request) -> list[Frame]:
    """A request → ``[topic][message][payload…]``. Raises InvalidRequest for what no message can hold."""
    row = BY_KIND[type(request)]
    try:
        return row.encode(request)
    except InvalidRequest:
        raise
    except (TypeError, ValueError, OverflowError) as error:  # protobuf's: wrong types, numbers out of range, half pairs
        said = _wrong_type(request) or _out_of_range(row.twin, request) or error
        name = getattr(request, "stream", "") or getattr(request, "name", "")
        whose = f" of {name!r}" if isinstance(name, str) and name else ""
        raise InvalidRequest(f"{type(request).__name__}{whose}: {said}") from None


_KINDS: dict[str, tuple[str, Callable[[Any], object]]] = {  # by annotation: what it is called, and what refuses others
    "str": ("text", "".__add__),
    "int": ("a whole number", operator.index),
    "float": ("a number", lambda value: value + 0.0),
    "bool": ("true or false", operator.index),
}


def _wrong_type(request: Any) -> str:
    """What is of a type that its field does not have, in words; empty if that is not the mistake."""
    import dataclasses  # here: only who errs needs it

    for field in dataclasses.fields(request):
        value, kind = getattr(request, field.name), str(field.type).removesuffix(" | None")
        each = kind.startswith("tuple[") and isinstance(value, (list, tuple))
        for one in value if each else () if value is None else (value,):
            if dataclasses.is_dataclass(one):
                found = _wrong_type(one)
            elif found := _unlike(kind.removeprefix("tuple[").removesuffix(", ...]"), one):
                found = f"{'each of its ' * each}{field.name} {found}"
            if found:
                return found
    return ""


def _unlike(kind: str, value: Any) -> str:
    """``is text, not 5 (int)``; empty if a value is of this kind."""
    said, check = _KINDS.get(kind, ("", None))
    try:
        if check is not None:
            check(value)
    except TypeError:
        advice = "; give them one by one" if isinstance(value, (list, tuple)) else ""
        return f"is {said}, not {value!r} ({type(value).__name__}){advice}"
    return ""


def _out_of_range(twin: Any, data: Any) -> str:
    """The first field that cannot be encoded on its own, as it was given; empty if that is not the mistake."""
    for name, value in zip(twin.names, twin.values(data), strict=False):
        if part := twin.parts.get(name):
            each = value if isinstance(value, tuple) else () if value is None else (value,)
            found = next(filter(None, (_out_of_range(part, one) for one in each)), "")
        else:
            found = "" if twin.fits(name, value) else f"{name}={value!r} is out of its range"
        if found:
            return found
    return ""


_BODIES: dict[type, tuple[str, Any]] = {}  # of a reply: the field of Reply, and what makes it and reads it
for _field in pb.Reply.DESCRIPTOR.oneofs_by_name["body"].fields:
    _message: Any = _field.message_type
    _BODIES[kind_of(_message.name)] = _field.name, CODECS[kind_of(_message.name)]
_FROM_FIELD = {field: its.from_pb for field, its in _BODIES.values()}


def encode_reply(topic: bytes, reply: st.Reply, sequence: int | None = None) -> list[Frame]:
    """A reply → ``[topic][Reply][payload…]``; `sequence` replaces the reply's own."""
    body, number = reply.body, reply.sequence if sequence is None else sequence
    begin = _well(number) if reply.error is None else _refused(reply.error, number)
    if body is None:
        encoded = reply.encoded
    elif type(body) is st.RegValues:
        if body.generation:
            message = pb.Reply()
            protobuf_messages.registers_into(message.registers, body)
            encoded = message.SerializeToString()
        else:  # of a read
            encoded = _read_registers(body)
    else:
        encoded = encode_body(body)
    return [topic, begin + encoded, *reply.payload]


# protobuf reads messages that follow each other as one; those that a client that polls a register gets are mostly equal


@lru_cache(8)
def _well(sequence: int) -> bytes:
    return pb.Reply(ok=True, sequence=sequence).SerializeToString()


@lru_cache(64)
def _read_registers(values: st.RegValues) -> bytes:
    return encode_body(values)


def _refused(error: st.ErrorInfo, sequence: int) -> bytes:
    return pb.Reply(error=protobuf_messages.ERROR.to_pb(error), sequence=sequence).SerializeToString()


def encode_body(body: Any) -> bytes:
    """As `st.Reply.encoded`: a long one takes more time than a request may in one go."""
    message = pb.Reply()
    if isinstance(body, st.RegValues):
        protobuf_messages.registers_into(message.registers, body)
    elif isinstance(body, st.Status):
        message.status.MergeFromString(protobuf_messages.STATUS.encoded(body))
    else:
        field, its = _BODIES[type(body)]
        getattr(message, field).CopyFrom(its.to_pb(body))
    return message.SerializeToString()


def decode_reply(frames: Sequence[Frame]) -> st.Reply:
    """``[topic][Reply][payload…]`` → the reply. Raises InvalidRequest for anything else."""
    if len(frames) < 2:
        raise InvalidRequest(f"a reply of {len(frames)} frames; [topic][Reply][payload…] is expected")
    try:
        message = pb.Reply.FromString(bytes(frames[1]))  # not `parsed`: each reply comes here
    except DecodeError as problem:
        raise InvalidRequest(f"a reply that is not a Reply message: {problem}") from problem
    field = message.WhichOneof("body")
    return st.Reply(
        body=_FROM_FIELD[field](getattr(message, field)) if field else None,
        error=None if message.ok else protobuf_messages.ERROR.from_pb(message.error),
        sequence=message.sequence,
        payload=tuple(frames[2:]),
    )


def encode_status(status: st.Status) -> list[Frame]:
    """A status → the frames published on ``cm_status``."""
    return [topics.STATUS, protobuf_messages.STATUS.encoded(status)]


def encode_registers(values: st.RegValues) -> list[Frame]:
    """Changed values → the frames published on ``cm_read_reg``."""
    return [topics.READ_REG, protobuf_messages.registers_to_pb(values).SerializeToString()]


def encode_irq(irq: st.Irq) -> list[Frame]:
    """An interrupt → the frames published on ``cm_irq``."""
    return [topics.IRQ, CODECS[st.Irq].to_pb(irq).SerializeToString()]


def encode_audit(
    request: rq.Request, client: str, account: str, pid: int, times: tuple[int, int], reply: st.Reply | None
) -> list[Frame]:
    """A request, and its reply where there is one → the frames published on ``cm_audit``."""
    began_ns, ended_ns = times
    told, body, error = pb.Audit(began_ns=began_ns, ended_ns=ended_ns), None, None
    if reply is not None:
        body, error = reply.body, reply.error
    if isinstance(body, (st.RegValues, st.ChangeInfo)):
        told.generation = body.generation
    if isinstance(body, st.ChangeInfo):
        told.change = body.number
    if error is not None:
        told.error.CopyFrom(protobuf_messages.ERROR.to_pb(error))
    repeated = type(request) is rq.WriteReg and len(request.writes) <= _REPEATED
    asked = (_asked_again if repeated else _asked)(request, client, account, pid)
    return [topics.AUDIT, asked + told.SerializeToString()]


def _asked(request: rq.Request, client: str, account: str, pid: int) -> bytes:
    """Who asked for what: an Audit of that alone."""
    secret = "id" if isinstance(request, (rq.RenewLease, rq.ReleaseLease)) else "lease"
    hidden: dict[str, Any] = {secret: ""} if getattr(request, secret, "") else {}
    shown: Any = replace(request, **hidden)
    topic, message, *_ = encode_request(shown)
    audit = st.Audit(type(request).__name__, bytes(topic).decode(), bytes(message), client, account, pid, 0)
    return encoded(audit)


_asked_again = lru_cache(64)(_asked)  # as decoded requests are kept


Event = st.Status | st.RegValues | st.Irq | st.FrameInfo | st.Audit


def decode_event(frames: Sequence[Frame]) -> Event:
    """A published message → its event; a frame's payload is ``frames[2]``.

    Raises InvalidRequest for a topic or message that is not one of the protocol.
    """
    topic = bytes(frames[0]) if frames else b""
    entry = _EVENTS.get(b"cm_stream" if topic.startswith(topics.STREAM_PREFIX) else topic)
    if entry is None or len(frames) < 2:
        raise InvalidRequest(f"no event is published as {topic!r} with {len(frames)} frames")
    event: Event = entry[1](parsed(entry[0], bytes(frames[1])))
    return event


_EVENTS: dict[bytes, tuple[type[Message], Callable[[Any], Any]]] = {
    topic: (message_of(kind), CODECS[kind].from_pb)
    for topic, kind in {
        topics.STATUS: st.Status,
        topics.READ_REG: st.RegValues,
        topics.IRQ: st.Irq,
        topics.AUDIT: st.Audit,
        **dict.fromkeys((topics.READ_DATA, topics.DATA_READ, b"cm_stream"), st.FrameInfo),
    }.items()
}
