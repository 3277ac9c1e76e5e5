# SPDX-License-Identifier: Apache-2.0
"""Frames → frozen requests: the server's reading side of the protocol."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.wire import bounds, parse, protobuf_messages, text, topics
from cm.wire import cm_pb2 as pb
from cm.wire.messages import requests as rq

Frame = bytes | memoryview
_SHORT, _KEPT = 256, 256  # bytes of the longest message whose request is kept, and how many are kept
_Decoder = Callable[[bytes, Sequence[Frame]], rq.Request]


def split_text(frames: Sequence[Frame]) -> list[Frame]:
    """``[b"cm_config edge"]`` → ``[b"cm_config", b"edge"]``: the paper's one-frame spelling."""
    if len(frames) == 1:
        topic, space, rest = bytes(frames[0]).partition(b" ")
        if space:
            return [topic, rest]
    return list(frames)


def decode_request(frames: Sequence[Frame]) -> rq.Request:
    """``[topic][message][payload…]`` → the request. Raises InvalidRequest, never anything else."""
    if len(frames) == 2 and len(frames[1]) <= _SHORT:
        return _decode_again(bytes(frames[0]), bytes(frames[1]))
    parts = split_text(frames)
    if not parts:
        raise InvalidRequest("an empty message; frames are [topic][message][payload…]")
    return _decode(bytes(parts[0]), bytes(parts[1]) if len(parts) > 1 else b"", parts[2:])


@lru_cache(_KEPT)
def _decode_again(topic: bytes, message: bytes) -> rq.Request:
    """Clients repeat requests for a register or the status byte for byte, so decoded ones are kept; they are frozen."""
    return _decode(topic, message, ())


def _decode(topic: bytes, message: bytes, payload: Sequence[Frame]) -> rq.Request:
    decoder = _DECODERS.get(topic)
    if decoder is None:
        known = ", ".join(sorted(t.decode() for t in _DECODERS))
        raise InvalidRequest(f"unknown topic {topic[:64].decode('utf-8', 'backslashreplace')!r}; topics are {known}")
    return decoder(message, payload)


def _no_payload(topic: str, payload: Sequence[Frame]) -> None:
    if payload:
        raise InvalidRequest(f"{topic}: {len(payload)} payload frames where none is expected")


def _read_status(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_status", payload)
    return rq.ReadStatus(parse.parse(pb.ReadStatus, "cm_status", message).clients)


def _read_config(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_read_config", payload)
    m = parse.parse(pb.ReadConfig, "cm_read_config", message)
    if m.list:
        return rq.ListConfigs()
    return rq.PlanChange(m.config_name, m.plan_mode) if m.plan or m.plan_mode else rq.ReadConfig(m.config_name)


def _text_config(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_config", payload)
    return text.parse_config(message)


def _write_config(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    if text.is_word(message):
        return _text_config(message, payload)
    m = parse.parse(pb.WriteConfig, "cm_write_config", message)
    parts = [f for f in m.files if not f.upload]
    if len(parts) != len(payload):
        raise InvalidRequest(
            f"cm_write_config: {len(parts)} files are named and {len(payload)} payload frames follow; one each"
        )
    if m.cancel:
        return rq.CancelChange()
    if m.remove:
        return _remove(m)
    change = rq.ChangeMode(m.config_name, m.mode, "", m.no_wait, m.no_queue, m.force, m.lease, m.undoable, m.undo)
    if not m.schema:
        if m.provision_only or m.files:  # without a word of its own it would be a change of the mode
            raise InvalidRequest("cm_write_config: the schema to be provisioned is empty (begin with config:)")
        return change
    data = iter(payload)
    files = tuple(_file(f, None if f.upload else next(data)) for f in m.files)
    change = replace(change, config_name="")  # the schema names it
    return rq.Provision(m.schema, files, None if m.provision_only else change, m.lease)


def _file(entry: pb.File, payload: Frame | None) -> rq.File:
    """A file as it came; checking its sha256 takes time, and is done where it is stored."""
    if payload is None:
        return rq.File(entry.name, b"", entry.sha256, entry.upload)
    if len(payload) != entry.length:
        raise InvalidRequest(
            f"cm_write_config: file {entry.name!r} has {len(payload)} bytes, {entry.length} were announced"
        )
    return rq.File(entry.name, payload, entry.sha256)


def _remove(m: pb.WriteConfig) -> rq.RemoveConfig:
    if not m.config_name or m.schema or m.mode:
        raise InvalidRequest("cm_write_config: to remove a configuration takes its config_name, and nothing else")
    return rq.RemoveConfig(m.config_name, m.lease)


def _read_reg(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_read_reg", payload)
    return rq.ReadReg(tuple(parse.parse(pb.ReadReg, "cm_read_reg", message).names))


def _write_reg(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_write_reg", payload)
    if text.is_mapping(message):
        return text.parse_registers(message)
    return bounds.in_one_go(parse.writes_in_slices(message))


def _data_config(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_data_config", payload)
    m = parse.parse(pb.DataConfig, "cm_data_config", message)
    if m.HasField("address") or m.length or m.access or m.region:
        return _define_memory(m)
    request = protobuf_messages.STREAM_SETTINGS.from_pb(m)
    return rq.DescribeData(m.stream, m.lease) if request == rq.ConfigureStream(m.stream, lease=m.lease) else request


def _define_memory(m: pb.DataConfig) -> rq.DefineMemory:
    address = m.address if m.HasField("address") else None
    return rq.DefineMemory(m.stream, address, m.length, tuple(m.shape), m.dtype, m.access, m.region, m.lease)


def _read_data(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_read_data", payload)
    m = parse.parse(pb.ReadData, "cm_read_data", message)
    if not m.timeout >= 0:  # nor is what is not a number
        raise InvalidRequest(f"cm_read_data: a time-out of {m.timeout} s; seconds are 0 (which stands for 1) or more")
    return rq.ReadData(m.stream, min(m.timeout, bounds.WAIT_SECONDS), m.offset, m.length)


def _write_data(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    m = parse.parse(pb.WriteData, "cm_write_data", message)
    if len(payload) != (0 if m.upload else 1):
        raise InvalidRequest(
            f"cm_write_data: {len(payload)} payload frames; one frame of data is expected, or an upload"
        )
    return rq.WriteData(m.stream, b"" if m.upload else payload[0], m.lease, m.offset, m.upload, m.format)


def _upload(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    m = parse.parse(pb.Upload, "cm_upload", message)
    if len(payload) != (0 if m.discard else 1) or not m.id:
        raise InvalidRequest(f"cm_upload: {len(payload)} payload frames, id {m.id!r}; an id and one frame are expected")
    return rq.Upload(m.id, m.length, m.offset, payload[0] if payload else b"", m.discard)


def _region(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_region", payload)
    m = parse.parse(pb.Region, "cm_region", message)
    if m.reload and not m.repair:
        raise InvalidRequest("cm_region: reload says how to repair; it goes with repair")
    if m.map and m.repair:
        raise InvalidRequest("cm_region: map compares nothing, and does not go with repair")
    if m.map:
        return rq.MapRegion(m.name)
    return protobuf_messages.REGION_CHECKED.from_pb(m)


def _read_irq(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_irq", payload)
    return rq.ReadIrq(parse.parse(pb.ReadIrq, "cm_irq", message).name)


def _lease(message: bytes, payload: Sequence[Frame]) -> rq.Request:
    _no_payload("cm_lease", payload)
    m = parse.parse(pb.Lease, "cm_lease", message)
    if m.release and m.number and not m.id:
        return rq.BreakLease(m.number)
    if m.release:
        return rq.ReleaseLease(m.id)
    if m.id:
        return protobuf_messages.LEASE_RENEWED.from_pb(m)
    if not m.scope:
        raise InvalidRequest(
            "cm_lease: no scope; it is one of board, config, region:NAME, registers:NAME, memories:NAME"
        )
    return protobuf_messages.LEASE_TAKEN.from_pb(m)


_DECODERS: dict[bytes, _Decoder] = {
    topics.STATUS: _read_status,
    topics.READ_CONFIG: _read_config,
    topics.WRITE_CONFIG: _write_config,
    topics.TEXT_CONFIG: _text_config,
    topics.READ_REG: _read_reg,
    topics.WRITE_REG: _write_reg,
    topics.DATA_CONFIG: _data_config,
    topics.READ_DATA: _read_data,
    topics.WRITE_DATA: _write_data,
    topics.IRQ: _read_irq,
    topics.LEASE: _lease,
    topics.UPLOAD: _upload,
    topics.REGION: _region,
}
TOPICS = frozenset(_DECODERS)  # of commands
