# SPDX-License-Identifier: Apache-2.0
"""Frozen requests → frames (a client's side), replies and events ↔ frames (both sides)."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from google.protobuf.message import DecodeError, Message

from cm.errors import InvalidRequest
from cm.frozen import names, replace
from cm.hashes import sha256
from cm.wire import cm_pb2 as pb
from cm.wire import protobuf_messages, topics
from cm.wire.messages import requests as rq
from cm.wire.messages import status as st

Frame = bytes | memoryview
_M = TypeVar("_M", bound=Message)
_CHANGE = protobuf_messages.Twin(
    rq.ChangeMode, pb.WriteConfig, [name for name in rq.ChangeMode.__annotations__ if name != "name_or_mode"]
)


def parsed(kind: type[_M], data: bytes) -> _M:
    """A message of this kind. Raises InvalidRequest."""
    try:
        return kind.FromString(data)
    except DecodeError as problem:
        raise InvalidRequest(f"the payload is not a valid {kind.__name__} message ({problem})") from problem


def encode_request(request: rq.Request) -> list[Frame]:
    """A request → ``[topic][message][payload…]``. Raises InvalidRequest for what no message can hold."""
    try:
        return _REQUESTS[type(request)](request)
    except InvalidRequest:
        raise
    except (TypeError, ValueError, OverflowError) as error:  # protobuf's: wrong types, numbers out of range, half pairs
        raise InvalidRequest(f"{type(request).__name__}: {_wrong_type(request) or error}") from None


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


def _change_mode(r: rq.ChangeMode) -> list[Frame]:
    if r.name_or_mode:
        return [topics.TEXT_CONFIG, r.name_or_mode.encode()]
    return [topics.WRITE_CONFIG, _CHANGE.to_pb(r).SerializeToString()]


def _provision(r: rq.Provision) -> list[Frame]:
    if not r.schema:  # on the wire that is a change of the mode
        raise InvalidRequest("the schema is empty (begin with config:)")
    files = [
        pb.File(name=f.name, upload=f.upload, sha256=f.sha256)
        if f.upload
        else pb.File(name=f.name, length=len(f.data), sha256=f.sha256 or sha256(f.data))
        for f in r.files
    ]
    message = _CHANGE.to_pb(r.change) if r.change is not None else pb.WriteConfig(provision_only=True)
    message.MergeFrom(pb.WriteConfig(schema=r.schema, files=files, lease=r.lease))
    return [topics.WRITE_CONFIG, message.SerializeToString(), *(f.data for f in r.files if not f.upload)]


def _write_reg(r: rq.WriteReg) -> list[Frame]:
    for write in r.writes:
        if not 0 <= write.value < 1 << 64:
            raise InvalidRequest(f"register {write.name!r}: value {write.value} does not fit 64 bits, unsigned")
    writes = [pb.RegWrite(name=w.name, value=w.value, mask=w.mask, named=w.named) for w in r.writes]
    return [topics.WRITE_REG, pb.WriteReg(writes=writes, lease=r.lease).SerializeToString()]


def _read_data(r: rq.ReadData) -> list[Frame]:
    _place(r.stream, r.offset, r.length)
    message = pb.ReadData(stream=r.stream, timeout=r.timeout, offset=r.offset, length=r.length)
    return [topics.READ_DATA, message.SerializeToString()]


def _write_data(r: rq.WriteData) -> list[Frame]:
    _place(r.stream, r.offset)
    return [
        topics.WRITE_DATA,
        pb.WriteData(
            stream=r.stream, lease=r.lease, offset=r.offset, upload=r.upload, format=r.format
        ).SerializeToString(),
        *(() if r.upload else (r.data,)),
    ]


def _upload(r: rq.Upload) -> list[Frame]:
    message = pb.Upload(id=r.id, length=r.length, offset=r.offset, discard=r.discard).SerializeToString()
    return [topics.UPLOAD, message, *(() if r.discard else (r.data,))]


def _place(name: str, *numbers: int) -> None:
    for number in numbers:
        if not 0 <= number < 1 << 64:
            raise InvalidRequest(
                f"memory {name!r}: {number} is no place or length in it: those are 0 or more, below 2⁶⁴"
            )


def _configure_stream(r: rq.ConfigureStream) -> list[Frame]:
    try:
        message = protobuf_messages.STREAM_SETTINGS.to_pb(r)
    except (TypeError, ValueError, OverflowError) as error:
        said = _wrong_type(r) or f"{_wrong_setting(r)} is out of its range: {error}"
        raise InvalidRequest(f"stream {r.stream!r}: {said}") from None
    return [topics.DATA_CONFIG, message.SerializeToString()]


def _wrong_setting(r: rq.ConfigureStream) -> str:
    """The first that cannot be encoded on its own, as it was given."""
    for name in names(rq.ConfigureStream):
        value = getattr(r, name)
        try:
            protobuf_messages.STREAM_SETTINGS.to_pb(replace(rq.ConfigureStream("s"), **{name: value}))
        except (TypeError, ValueError, OverflowError):
            return f"{name}={value!r}"
    return "a setting"


def _define_memory(r: rq.DefineMemory) -> list[Frame]:
    _place(r.name, r.address or 0, r.length)
    try:
        message = pb.DataConfig(
            stream=r.name,
            address=r.address,
            length=r.length,
            shape=r.shape,
            dtype=r.dtype,
            access=r.access,
            region=r.region,
            lease=r.lease,
        )
    except (TypeError, ValueError, OverflowError) as error:
        said = _wrong_type(r) or f"a property is out of its range: {error}"
        raise InvalidRequest(f"memory {r.name!r}: {said}") from None
    return [topics.DATA_CONFIG, message.SerializeToString()]


def _lease(message: pb.Lease) -> list[Frame]:
    return [topics.LEASE, message.SerializeToString()]


def _config(message: pb.ReadConfig) -> list[Frame]:
    return [topics.READ_CONFIG, message.SerializeToString()]


_REQUESTS: dict[type, Callable[[Any], list[Frame]]] = {
    rq.ReadStatus: lambda r: [topics.STATUS, pb.ReadStatus(clients=r.clients).SerializeToString()],
    rq.ReadConfig: lambda r: _config(pb.ReadConfig(config_name=r.config_name)),
    rq.ListConfigs: lambda _: _config(pb.ReadConfig(list=True)),
    rq.PlanChange: lambda r: _config(pb.ReadConfig(config_name=r.config_name, plan_mode=r.mode, plan=True)),
    rq.ChangeMode: _change_mode,
    rq.CancelChange: lambda _: [topics.WRITE_CONFIG, pb.WriteConfig(cancel=True).SerializeToString()],
    rq.Provision: _provision,
    rq.RemoveConfig: lambda r: [
        topics.WRITE_CONFIG,
        pb.WriteConfig(config_name=r.config_name, remove=True, lease=r.lease).SerializeToString(),
    ],
    rq.ReadReg: lambda r: [topics.READ_REG, pb.ReadReg(names=r.names).SerializeToString()],
    rq.WriteReg: _write_reg,
    rq.DescribeData: lambda r: [
        topics.DATA_CONFIG,
        pb.DataConfig(stream=r.name, lease=r.lease).SerializeToString(),
    ],
    rq.ConfigureStream: _configure_stream,
    rq.DefineMemory: _define_memory,
    rq.ReadData: _read_data,
    rq.WriteData: _write_data,
    rq.Upload: _upload,
    rq.CheckRegion: lambda r: [topics.REGION, protobuf_messages.REGION_CHECKED.to_pb(r).SerializeToString()],
    rq.MapRegion: lambda r: [topics.REGION, pb.Region(name=r.name, map=True).SerializeToString()],
    rq.ReadIrq: lambda r: [topics.IRQ, pb.ReadIrq(name=r.name).SerializeToString()],
    rq.TakeLease: lambda r: _lease(protobuf_messages.LEASE_TAKEN.to_pb(r)),
    rq.RenewLease: lambda r: _lease(protobuf_messages.LEASE_RENEWED.to_pb(r)),
    rq.BreakLease: lambda r: _lease(pb.Lease(number=r.number, release=True)),
    rq.ReleaseLease: lambda r: _lease(pb.Lease(id=r.id, release=True)),
}

# body type → field of Reply, and the pair of functions of cm.wire.protobuf_messages
_BODIES: dict[type, tuple[str, Callable[[Any], Any], Callable[[Any], Any]]] = {
    st.Status: ("status", protobuf_messages.STATUS.to_pb, protobuf_messages.STATUS.from_pb),
    st.ConfigInfo: ("config", protobuf_messages.CONFIG.to_pb, protobuf_messages.CONFIG.from_pb),
    st.RegValues: ("registers", protobuf_messages.registers_to_pb, protobuf_messages.registers_from_pb),
    st.FrameInfo: ("frame", protobuf_messages.FRAME.to_pb, protobuf_messages.FRAME.from_pb),
    st.PlanInfo: ("plan", protobuf_messages.PLAN.to_pb, protobuf_messages.PLAN.from_pb),
    st.LeaseInfo: ("lease", protobuf_messages.LEASE.to_pb, protobuf_messages.LEASE.from_pb),
    st.ChangeInfo: ("change", protobuf_messages.CHANGE.to_pb, protobuf_messages.CHANGE.from_pb),
    st.Irq: ("irq", protobuf_messages.IRQ.to_pb, protobuf_messages.IRQ.from_pb),
    st.UploadInfo: (
        "upload",
        lambda x: pb.Upload(id=x.id, length=x.length, offset=x.got),
        lambda m: st.UploadInfo(m.id, m.length, m.offset),
    ),
    st.RegionCheck: ("region", protobuf_messages.CHECK.to_pb, protobuf_messages.CHECK.from_pb),
    st.RegionMap: ("region_map", protobuf_messages.MAP.to_pb, protobuf_messages.MAP.from_pb),
    st.MemoryInfo: ("memory", protobuf_messages.MEMORY.to_pb, protobuf_messages.MEMORY.from_pb),
    st.StreamStatus: (
        "stream",
        lambda s: pb.Stream(state=protobuf_messages.STREAM.to_pb(s)),
        lambda m: protobuf_messages.STREAM.from_pb(m.state),
    ),
}
_FROM_FIELD = {field: decode for field, _, decode in _BODIES.values()}


def encode_reply(topic: bytes, reply: st.Reply, sequence: int | None = None) -> list[Frame]:
    """A reply → ``[topic][Reply][payload…]``; `sequence` replaces the reply's own."""
    body, error = reply.body, reply.error
    message = pb.Reply()
    message.ok = error is None
    message.sequence = reply.sequence if sequence is None else sequence
    if error is not None:
        message.error.CopyFrom(protobuf_messages.ERROR.to_pb(error))
    if isinstance(body, st.RegValues):
        protobuf_messages.registers_into(message.registers, body)
    elif isinstance(body, st.Status):
        message.status.MergeFromString(protobuf_messages.STATUS.encoded(body))
    elif body is not None:
        field, to_pb, _ = _BODIES[type(body)]
        getattr(message, field).CopyFrom(to_pb(body))
    return [topic, message.SerializeToString() + reply.encoded, *reply.payload]


def encode_config(info: st.ConfigInfo) -> bytes:
    """As `st.Reply.encoded`: a long one takes more time than a request may in one go."""
    return pb.Reply(config=protobuf_messages.CONFIG.to_pb(info)).SerializeToString()


def encode_table(info: st.ConfigInfo) -> bytes:
    """A `Config` message by itself: the registers of a window."""
    return protobuf_messages.CONFIG.to_pb(info).SerializeToString()


def decode_table(data: bytes) -> st.ConfigInfo:
    """The inverse of `encode_table`. Raises InvalidRequest."""
    try:
        return protobuf_messages.CONFIG.from_pb(pb.Config.FromString(data))
    except DecodeError as error:
        raise InvalidRequest(f"the registers of a window: {error}") from error


class RegisterReply:
    """A reply that holds registers, kept to be filled in again: a third of the time that a new one takes.

    A client that polls a register mostly finds the same value as before; then the bytes are the same, too. `fields`
    are, for each name, those to extract from the register's value: name, lowest bit, mask.
    """

    def __init__(
        self, names: Sequence[str], fields: Sequence[Sequence[tuple[str, int, int]]], config_name: str, mode: str
    ) -> None:
        empty = st.RegValues(tuple([st.RegValue(name, 0) for name in names]), config_name, mode)
        self._message = pb.Reply(ok=True, registers=protobuf_messages.registers_to_pb(empty))
        self._entries = list(zip(self._message.registers.values, fields, strict=True))
        self._last: tuple[Sequence[int], int, bytes] = ((), -1, b"")

    def encode(self, values: Sequence[int], sequence: int) -> bytes:
        """The message of `encode_reply`, in the order of the names."""
        before, then, encoded = self._last
        if sequence == then and values == before:
            return encoded
        self._message.sequence = sequence
        for (entry, fields), value in zip(self._entries, values):  # noqa: B905 (they are as many)
            entry.value = value
            for name, lsb, mask in fields:
                entry.fields[name] = (value & mask) >> lsb
        encoded = self._message.SerializeToString()
        self._last = values, sequence, encoded
        return encoded


def decode_reply(frames: Sequence[Frame]) -> st.Reply:
    """``[topic][Reply][payload…]`` → the reply. Raises InvalidRequest for anything else."""
    if len(frames) < 2:
        raise InvalidRequest(f"a reply of {len(frames)} frames; [topic][Reply][payload…] is expected")
    try:
        message = pb.Reply.FromString(bytes(frames[1]))
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
    return [topics.IRQ, protobuf_messages.IRQ.to_pb(irq).SerializeToString()]


def encode_frame_info(info: st.FrameInfo) -> bytes:
    """The message beside a frame's payload."""
    return bytes(protobuf_messages.FRAME.to_pb(info).SerializeToString())


def decode_plan(data: bytes) -> st.PlanInfo:
    """A Plan message. Raises InvalidRequest."""
    return protobuf_messages.PLAN.from_pb(parsed(pb.Plan, data))


def decode_registers(data: bytes) -> st.RegValues:
    """A RegValues message. Raises InvalidRequest."""
    return protobuf_messages.registers_from_pb(parsed(pb.RegValues, data))


Event = st.Status | st.RegValues | st.Irq | st.FrameInfo


def decode_event(frames: Sequence[Frame]) -> Event:
    """A published message → its event; a frame's payload is ``frames[2]``.

    Raises InvalidRequest for a topic or message that is not one of the protocol.
    """
    topic = bytes(frames[0]) if frames else b""
    entry = _EVENTS.get(b"cm_stream" if topic.startswith((topics.STREAM_PREFIX, topics.LZ4_PREFIX)) else topic)
    if entry is None or len(frames) < 2:
        raise InvalidRequest(f"no event is published as {topic!r} with {len(frames)} frames")
    message = entry[0]()
    try:
        message.ParseFromString(bytes(frames[1]))
    except DecodeError as problem:
        raise InvalidRequest(f"{topic.decode(errors='backslashreplace')}: {problem}") from problem
    event: Event = entry[1](message)
    return event


_EVENTS: dict[bytes, tuple[Callable[[], Any], Callable[[Any], Any]]] = {
    topics.STATUS: (pb.Status, protobuf_messages.STATUS.from_pb),
    topics.READ_REG: (pb.RegValues, protobuf_messages.registers_from_pb),
    topics.IRQ: (pb.Irq, protobuf_messages.IRQ.from_pb),
    topics.READ_DATA: (pb.Frame, protobuf_messages.FRAME.from_pb),
    topics.DATA_READ: (pb.Frame, protobuf_messages.FRAME.from_pb),
    b"cm_stream": (pb.Frame, protobuf_messages.FRAME.from_pb),
}
