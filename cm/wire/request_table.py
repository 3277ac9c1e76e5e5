# SPDX-License-Identifier: Apache-2.0
"""Every request on the wire, a row each: its topic, its message, what marks it there, and what comes behind.

A message is the request of its topic whose marks it has, and which has all the fields that it sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from google.protobuf.message import Message

from cm.errors import InvalidRequest
from cm.frozen import names, replace
from cm.hashes import sha256
from cm.wire import bounds, topics
from cm.wire import cm_pb2 as pb
from cm.wire.messages import requests as rq
from cm.wire.protobuf_messages import Twin

Frame = bytes | memoryview


class Row:
    """How one kind of request travels. Fields have the same names in the request and in the message."""

    def __init__(
        self,
        kind: type,
        topic: bytes,
        message: type[Message],
        *,
        marks: Sequence[str] = (),
        but: str = "",
        payload: str = "",
        unless: str = "",
        renamed: dict[str, str] | None = None,
        checked: Callable[[Any], Any] | None = None,
        **parts: Any,
    ) -> None:
        """`marks`: fields of the message that tell the request from others of the topic; those that it does not have
        itself are true. `but`: a field that is not in the message. `payload`: the field that comes in a frame behind
        it, `unless` another one is set. `checked` returns a request that came, or raises InvalidRequest. `renamed` and
        `parts`: as in `Twin`.
        """
        self.kind, self.topic, self.message = kind, topic, message
        self.payload, self.unless, self._checked = payload, unless, checked
        own = [name for name in names(kind) if name not in (payload, but)]
        self.twin: Twin[Any, Any] = Twin(kind, message, own, renamed=renamed, **parts)
        self.marks, self.fields = frozenset(marks), frozenset(marks).union(self.twin.theirs)
        self.true = dict.fromkeys(self.marks.difference(self.twin.theirs), True)

    def encode(self, request: Any) -> list[Frame]:
        """``[topic][message][payload…]``. Raises TypeError, ValueError, OverflowError for what no message can hold."""
        twin = self.twin
        given = twin.given(request) if twin.parts else dict(zip(twin.theirs, twin.values(request), strict=False))
        frames: list[Frame] = [self.topic, self.message(**given, **self.true).SerializeToString()]
        if self.payload and not (self.unless and getattr(request, self.unless)):
            frames.append(request.data)
        return frames

    def decode(self, message: Any, payload: Sequence[Frame]) -> Any:
        """The request. Raises InvalidRequest."""
        wanted = 0 if not self.payload or (self.unless and getattr(message, self.unless)) else 1
        if len(payload) != wanted:
            also = f", or {self.unless}" if self.unless else ""
            said = f"one frame of data is expected{also}" if self.payload else "none is expected"
            raise InvalidRequest(f"{self.topic.decode()}: {len(payload)} payload frames where {said}")
        given = {self.payload: payload[0]} if wanted else {}
        request = self.twin.from_pb(message, **given)
        return self._checked(request) if self._checked else request


class _ModeRow(Row):
    """A change of mode may be one word of plain text."""

    def encode(self, request: rq.ChangeMode) -> list[Frame]:
        return [topics.TEXT_CONFIG, request.name_or_mode.encode()] if request.name_or_mode else super().encode(request)


class _ProvisionRow(Row):
    """A schema, its files as payload frames, and in the same message the change that follows."""

    def __init__(self) -> None:
        super().__init__(rq.Provision, topics.WRITE_CONFIG, pb.WriteConfig)
        self.fields = CHANGE_MODE.fields - {"unload"} | {"schema", "files", "provision_only"}

    def encode(self, request: rq.Provision) -> list[Frame]:
        if not request.schema:
            raise InvalidRequest("the schema is empty (begin with config:)")
        change = CHANGE_MODE.twin.to_pb(request.change) if request.change else pb.WriteConfig(provision_only=True)
        files = [_file_to_pb(file) for file in request.files]
        change.MergeFrom(pb.WriteConfig(schema=request.schema, files=files, lease=request.lease))
        return [self.topic, change.SerializeToString(), *(file.data for file in request.files if not file.upload)]

    def decode(self, message: pb.WriteConfig, payload: Sequence[Frame]) -> rq.Provision:
        if not message.schema:
            raise InvalidRequest("cm_write_config: the schema to be provisioned is empty (begin with config:)")
        parts = sum(not file.upload for file in message.files)
        if parts != len(payload):
            raise InvalidRequest(
                f"cm_write_config: {parts} files are named and {len(payload)} payload frames follow; one each"
            )
        data = iter(payload)
        files = tuple([_file_from_pb(file, b"" if file.upload else next(data)) for file in message.files])
        change = None
        if not message.provision_only:
            change = replace(CHANGE_MODE.twin.from_pb(message), config_name="")  # the schema names it
        return rq.Provision(message.schema, files, change=change, lease=message.lease)


def _file_to_pb(file: rq.File) -> pb.File:
    if file.upload:
        return pb.File(name=file.name, upload=file.upload, sha256=file.sha256)
    return pb.File(name=file.name, length=len(file.data), sha256=file.sha256 or sha256(file.data))


def _file_from_pb(entry: pb.File, data: Frame) -> rq.File:
    """A file as it came; checking its sha256 takes time, and is done where it is stored."""
    if not entry.upload and len(data) != entry.length:
        raise InvalidRequest(
            f"cm_write_config: file {entry.name!r} has {len(data)} bytes, {entry.length} were announced"
        )
    return rq.File(entry.name, data, sha256=entry.sha256, upload=entry.upload)


def _within_a_day(request: rq.ReadData) -> rq.ReadData:
    if not request.timeout >= 0:  # nor is what is not a number
        raise InvalidRequest(f"cm_read_data: a time-out of {request.timeout} s; seconds are 0 (for 1) or more")
    return replace(request, timeout=min(request.timeout, bounds.WAIT_SECONDS))


def _with_id(request: rq.Upload) -> rq.Upload:
    if not request.id:
        raise InvalidRequest("cm_upload: the id is empty; choose one")
    return request


def _reloads_to_repair(request: rq.CheckRegion) -> rq.CheckRegion:
    if request.reload and not request.repair:
        raise InvalidRequest("cm_region: reload says how to repair; it goes with repair")
    return request


def _with_scope(request: rq.TakeLease) -> rq.TakeLease:
    if not request.scope:
        raise InvalidRequest(
            "cm_lease: no scope; it is one of board, config, region:NAME, registers:NAME, memories:NAME"
        )
    return request


CHANGE_MODE = _ModeRow(rq.ChangeMode, topics.WRITE_CONFIG, pb.WriteConfig, but="name_or_mode")
ROWS = (
    Row(rq.ReadStatus, topics.STATUS, pb.ReadStatus),
    Row(rq.ReadConfig, topics.READ_CONFIG, pb.ReadConfig),
    Row(rq.ListConfigs, topics.READ_CONFIG, pb.ReadConfig, marks=("list",)),
    Row(rq.PlanChange, topics.READ_CONFIG, pb.ReadConfig, marks=("plan",), renamed={"mode": "plan_mode"}),
    CHANGE_MODE,
    Row(rq.CancelChange, topics.WRITE_CONFIG, pb.WriteConfig, marks=("cancel",), but="number"),
    _ProvisionRow(),
    Row(rq.RemoveConfig, topics.WRITE_CONFIG, pb.WriteConfig, marks=("remove",)),
    Row(rq.ReadReg, topics.READ_REG, pb.ReadReg),
    Row(rq.WriteReg, topics.WRITE_REG, pb.WriteReg, writes=Twin(rq.RegWrite, pb.RegWrite)),
    Row(rq.DescribeData, topics.DATA_CONFIG, pb.DataConfig, renamed={"name": "stream"}),
    Row(rq.ConfigureStream, topics.DATA_CONFIG, pb.DataConfig),
    Row(rq.DefineMemory, topics.DATA_CONFIG, pb.DataConfig, renamed={"name": "stream"}),
    Row(rq.ReadData, topics.READ_DATA, pb.ReadData, checked=_within_a_day),
    Row(rq.WriteData, topics.WRITE_DATA, pb.WriteData, payload="data", unless="upload"),
    Row(rq.Upload, topics.UPLOAD, pb.Upload, payload="data", unless="discard", checked=_with_id),
    Row(rq.CheckRegion, topics.REGION, pb.Region, checked=_reloads_to_repair),
    Row(rq.MapRegion, topics.REGION, pb.Region, marks=("map",)),
    Row(rq.ReadIrq, topics.IRQ, pb.ReadIrq),
    Row(rq.TakeLease, topics.LEASE, pb.Lease, checked=_with_scope),
    Row(rq.RenewLease, topics.LEASE, pb.Lease, marks=("id",)),
    Row(rq.ReleaseLease, topics.LEASE, pb.Lease, marks=("release",)),
    Row(rq.BreakLease, topics.LEASE, pb.Lease, marks=("number", "release")),
)
BY_KIND = {row.kind: row for row in ROWS}
BY_TOPIC = {row.topic: tuple([r for r in ROWS if r.topic == row.topic]) for row in ROWS}


def row_of(topic: bytes, message: Message) -> Row:
    """The request of a topic that a message is. Raises InvalidRequest."""
    rows = BY_TOPIC[topic]
    if len(rows) == 1:
        return rows[0]
    given = {field.name for field, _ in message.ListFields()}
    for row in rows:
        if row.marks <= given <= row.fields:
            return row
    known = "; ".join(f"{row.kind.__name__} ({', '.join(sorted(row.fields))})" for row in rows)
    raise InvalidRequest(f"{topic.decode()}: {', '.join(sorted(given))} are no request together; there are {known}")
