# SPDX-License-Identifier: Apache-2.0
"""Status, events and reply bodies ↔ protobuf messages, side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from cm.wire import cm_pb2 as pb
from cm.wire.messages import status as st


def lease_state_to_pb(x: st.LeaseStatus) -> pb.LeaseState:
    return pb.LeaseState(
        number=x.number,
        scope=x.scope,
        exclusive=x.exclusive,
        holder=x.holder,
        client=x.client,
        pid=x.pid,
        seconds=x.seconds,
    )


def lease_state_from_pb(m: pb.LeaseState) -> st.LeaseStatus:
    return st.LeaseStatus(m.number, m.scope, m.exclusive, m.holder, m.client, m.pid, m.seconds)


def window_to_pb(x: st.WindowStatus) -> pb.WindowState:
    return pb.WindowState(**x._asdict())


def window_from_pb(m: pb.WindowState) -> st.WindowStatus:
    what = m.number, m.region, m.module, m.address, m.length, m.writes, m.exclusive
    return st.WindowStatus(*what, m.client, m.pid)


def client_to_pb(x: st.ClientStatus) -> pb.ClientState:
    return pb.ClientState(
        name=x.name,
        connections=x.connections,
        leases=x.leases,
        slots=x.slots,
        upload_bytes=x.upload_bytes,
        waiting_bytes=x.waiting_bytes,
        loop_seconds=x.loop_seconds,
        requests=x.requests,
        refused=x.refused,
        account=x.account,
        waiting=x.waiting,
        memory_bytes=x.memory_bytes,
        unread_bytes=x.unread_bytes,
    )


def client_from_pb(m: pb.ClientState) -> st.ClientStatus:
    return st.ClientStatus(
        m.name,
        m.connections,
        m.leases,
        m.slots,
        m.upload_bytes,
        m.waiting_bytes,
        m.loop_seconds,
        m.requests,
        m.refused,
        m.account,
        m.waiting,
        m.memory_bytes,
        m.unread_bytes,
    )


_PR_MODES = tuple(st.PrMode)  # in the order of the enum PrMode of cm.proto
_PR_NUMBERS: dict[st.PrMode, Any] = {mode: number for number, mode in enumerate(_PR_MODES)}


def error_to_pb(error: st.ErrorInfo) -> pb.Error:
    return pb.Error(code=error.code, message=error.message)


def error_from_pb(m: pb.Error) -> st.ErrorInfo:
    return st.ErrorInfo(m.code, m.message)


def status_to_pb(s: st.Status) -> pb.Status:
    return pb.Status.FromString(encoded_status(s))


def encoded_status(s: st.Status) -> bytes:
    """The message of a status, in two parts: protobuf reads messages that follow each other as one."""
    message = pb.Status(
        config_name=s.config_name,
        mode=s.mode,
        fpga_busy=s.fpga_busy,
        pr_mode=_PR_NUMBERS[s.pr_mode],
        sequence=s.sequence,
        last_change=s.last_change,
        last_change_seconds=s.last_change_seconds,
        realtime_offset_ns=s.realtime_offset_ns,
        generation=s.generation,
    )
    for region in s.regions:
        told = message.regions.add(
            name=region.name, module=region.module or "", state=region.state, loader=region.loader
        )
        if region.health is not None:
            told.health.CopyFrom(_health_to_pb(region.health))
    if s.progress is not None:
        message.progress.CopyFrom(_progress_to_pb(s.progress))
    if s.last_error is not None:
        message.last_error.CopyFrom(error_to_pb(s.last_error))
    if s.leases:
        message.leases.extend([lease_state_to_pb(x) for x in s.leases])
    if s.windows:
        message.windows.extend([window_to_pb(x) for x in s.windows])
    if s.clients:
        message.clients.extend([client_to_pb(x) for x in s.clients])
    lasting = s.configs, s.streams, s.sensors, s.clocks, s.version, s.started_ns, s.board
    return bytes(_LASTING.encoded(lasting) + message.SerializeToString())


_Lasting = tuple[
    tuple[str, ...],
    tuple[st.StreamStatus, ...],
    tuple[st.SensorStatus, ...],
    tuple[st.ClockStatus, ...],
    str,
    int,
    str,
]


class _LastingParts:
    """The longest parts of a status, encoded: they are the same in the dozen statuses of one change of mode."""

    def __init__(self) -> None:
        self._last: tuple[_Lasting | None, bytes] = (None, b"")

    def encoded(self, parts: _Lasting) -> bytes:
        """The encoded form of these parts; objects that are identical to those of last time are not encoded again."""
        before, encoded = self._last
        if parts != before:
            encoded = _encoded_parts(*parts)
            self._last = parts, encoded
        return encoded


_LASTING = _LastingParts()


def _encoded_parts(
    configs: tuple[str, ...],
    streams: tuple[st.StreamStatus, ...],
    sensors: tuple[st.SensorStatus, ...],
    clocks: tuple[st.ClockStatus, ...],
    version: str,
    started_ns: int,
    board: str,
) -> bytes:
    message = pb.Status(
        configs=configs,
        streams=[stream_to_pb(x) for x in streams],
        sensors=[pb.SensorState(device=x.device, name=x.name, quantity=x.quantity, value=x.value) for x in sensors],
        clocks=_clocks_to_pb(clocks),
        version=version,
        started_ns=started_ns,
        board=board,
    )
    return message.SerializeToString()


def status_from_pb(m: pb.Status) -> st.Status:
    return st.Status(
        config_name=m.config_name,
        mode=m.mode,
        fpga_busy=m.fpga_busy,
        pr_mode=_PR_MODES[m.pr_mode] if 0 <= m.pr_mode < len(_PR_MODES) else st.PrMode.ERROR,
        progress=_progress_from_pb(m.progress) if m.HasField("progress") else None,
        sequence=m.sequence,
        last_error=error_from_pb(m.last_error) if m.HasField("last_error") else None,
        regions=tuple(
            st.RegionStatus(
                r.name,
                r.module or None,
                r.state,
                r.loader,
                _health_from_pb(r.health) if r.HasField("health") else None,
            )
            for r in m.regions
        ),
        streams=tuple(stream_from_pb(x) for x in m.streams),
        configs=tuple(m.configs),
        version=m.version,
        started_ns=m.started_ns,
        last_change=m.last_change,
        last_change_seconds=m.last_change_seconds,
        clocks=_clocks_from_pb(m.clocks),
        board=m.board,
        realtime_offset_ns=m.realtime_offset_ns,
        generation=m.generation,
        sensors=tuple([st.SensorStatus(x.device, x.name, x.quantity, x.value) for x in m.sensors]),
        leases=tuple(lease_state_from_pb(x) for x in m.leases),
        clients=tuple(client_from_pb(x) for x in m.clients),
        windows=tuple([window_from_pb(x) for x in m.windows]),
    )


def _health_to_pb(h: st.RegionHealth) -> pb.RegionHealth:
    return pb.RegionHealth(
        checks=h.checks,
        upsets=h.upsets,
        repairs=h.repairs,
        wrong_bits=h.wrong_bits,
        frames=h.frames,
        unjudged=h.unjudged,
    )


def _health_from_pb(m: pb.RegionHealth) -> st.RegionHealth:
    return st.RegionHealth(m.checks, m.upsets, m.repairs, m.wrong_bits, m.frames, m.unjudged)


def check_to_pb(c: st.RegionCheck) -> pb.RegionCheck:
    return pb.RegionCheck(
        region=c.region,
        module=c.module,
        verdict=c.verdict,
        frames=c.frames,
        unjudged=c.unjudged,
        why=c.why,
        wrong_frames=c.wrong_frames,
        wrong_bits=c.wrong_bits,
        wrong=[
            pb.FrameError(far=x.far, block_type=x.block_type, row=x.row, column=x.column, minor=x.minor, bits=x.bits)
            for x in c.wrong
        ],
        repaired=c.repaired,
        seconds=c.seconds,
        change=c.change,
        config_name=c.config_name,
        mode=c.mode,
    )


def check_from_pb(m: pb.RegionCheck) -> st.RegionCheck:
    wrong = tuple([st.FrameError(x.far, x.block_type, x.row, x.column, x.minor, tuple(x.bits)) for x in m.wrong])
    counted = m.frames, m.unjudged, m.why, m.wrong_frames, m.wrong_bits, wrong
    return st.RegionCheck(
        m.region, m.module, m.verdict, *counted, m.repaired, m.seconds, m.change, m.config_name, m.mode
    )


def map_to_pb(m: st.RegionMap) -> pb.RegionMap:
    columns = [pb.RegionColumn(**column._asdict()) for column in m.columns]
    return pb.RegionMap(region=m.region, module=m.module, device=m.device, config_name=m.config_name, columns=columns)


def map_from_pb(m: pb.RegionMap) -> st.RegionMap:
    columns = [st.RegionColumn(c.far, tuple(c.bits), tuple(c.switches), tuple(c.logic), c.clock) for c in m.columns]
    return st.RegionMap(m.region, m.module, m.device, m.config_name, tuple(columns))


def _clocks_to_pb(clocks: Iterable[st.ClockStatus]) -> list[pb.ClockState]:
    return [pb.ClockState(name=c.name, wanted=c.wanted, rate=c.rate) for c in clocks]


def _clocks_from_pb(clocks: Iterable[pb.ClockState]) -> tuple[st.ClockStatus, ...]:
    return tuple(st.ClockStatus(c.name, c.wanted, c.rate) for c in clocks)


def _progress_to_pb(p: st.Progress) -> pb.Progress:
    return pb.Progress(
        change=p.change,
        target_config=p.target_config,
        target_mode=p.target_mode,
        step=p.step,
        subject=p.subject,
        bytes_done=p.bytes_done,
        bytes_total=p.bytes_total,
        fraction=p.fraction,
    )


def _progress_from_pb(m: pb.Progress) -> st.Progress:
    return st.Progress(
        m.change, m.target_config, m.target_mode, m.step, m.subject, m.bytes_done, m.bytes_total, m.fraction
    )


def stream_to_pb(s: st.StreamStatus) -> pb.StreamState:
    return pb.StreamState(
        name=s.name,
        channel=s.channel,
        direction=s.direction,
        shape=s.shape,
        dtype=s.dtype,
        slots=s.slots,
        open=s.open,
        frames=s.frames,
        dropped=s.dropped,
        errors=s.errors,
        rate=s.rate,
        latency_us=s.latency_us,
        clients=[_client_to_pb(c) for c in s.clients],
        overruns=s.overruns,
        cyclic=s.cyclic,
        backpressure=s.backpressure,
        stride=s.stride,
        limit=s.limit,
        exact=s.exact,
        max_length=s.max_length,
        last_error=None if s.last_error is None else error_to_pb(s.last_error),
        format=s.format,
    )


def _client_to_pb(c: st.StreamClient) -> pb.StreamClient:
    return pb.StreamClient(
        pid=c.pid, name=c.name, writes=c.writes, depth=c.depth, held=c.held, frames=c.frames, dropped=c.dropped
    )


def stream_from_pb(m: pb.StreamState) -> st.StreamStatus:
    return st.StreamStatus(
        m.name,
        m.channel,
        m.direction,
        tuple(m.shape),
        m.dtype,
        m.slots,
        m.open,
        m.frames,
        m.dropped,
        m.errors,
        m.rate,
        m.latency_us,
        tuple(st.StreamClient(c.pid, c.name, c.writes, c.depth, c.held, c.frames, c.dropped) for c in m.clients),
        m.overruns,
        m.cyclic,
        m.backpressure,
        m.stride,
        m.limit,
        m.exact,
        m.max_length,
        error_from_pb(m.last_error) if m.HasField("last_error") else None,
        m.format,
    )


def registers_to_pb(r: st.RegValues) -> pb.RegValues:
    message = pb.RegValues()
    registers_into(message, r)
    return message


class EncodedRegisters(st.RegValues):
    """Values of which `encoded` are the bytes: made some at a time where they are many."""

    encoded: bytes


def encode_values(values: Sequence[st.RegValue]) -> bytes:
    """Some of a message's values; such parts, one behind the other, are those of all."""
    return registers_to_pb(st.RegValues(tuple(values))).SerializeToString()


def encoded_registers(r: st.RegValues, parts: Iterable[bytes]) -> st.RegValues:
    """The same values, of which these are the parts."""
    made = EncodedRegisters(*r)
    made.encoded = b"".join(parts)
    return made


def registers_into(message: pb.RegValues, r: st.RegValues) -> None:
    """Fill a message in place, in a third of the time that keyword arguments and a copy take."""
    message.config_name = r.config_name
    message.mode = r.mode
    message.generation = r.generation
    if type(r) is EncodedRegisters:
        message.MergeFromString(r.encoded)
        return
    for value in r.values:
        entry = message.values.add()
        entry.name = value.name
        entry.value = value.value
        if value.fields:
            entry.fields.update(value.fields)


def registers_from_pb(m: pb.RegValues) -> st.RegValues:
    return st.RegValues(tuple([_value_from_pb(v) for v in m.values]), m.config_name, m.mode, m.generation)


def _value_from_pb(m: pb.RegValue) -> st.RegValue:
    fields = m.fields
    return st.RegValue(m.name, m.value, tuple(sorted([(name, fields[name]) for name in fields])) if fields else ())


def config_to_pb(c: st.ConfigInfo) -> pb.Config:
    return pb.Config(
        name=c.name,
        type=c.type,
        mode=c.mode,
        modes=[
            pb.ModeInfo(name=x.name, modules=x.modules, registers=x.registers, overlays=x.overlays) for x in c.modes
        ],
        registers=[_register_to_pb(r) for r in c.registers],
        interrupts=[pb.InterruptInfo(name=i.name, doc=i.doc, count=i.count) for i in c.interrupts],
        streams=[stream_to_pb(s) for s in c.streams],
        names=c.names,
        schema=c.schema,
        memories=[memory_to_pb(x) for x in c.memories],
        entries=[
            pb.ConfigEntry(
                name=e.name,
                type=e.type,
                modes=e.modes,
                default_mode=e.default_mode,
                origin=e.origin,
                owner=e.owner,
                bytes=e.bytes,
            )
            for e in c.entries
        ],
    )


def config_from_pb(m: pb.Config) -> st.ConfigInfo:
    return st.ConfigInfo(
        name=m.name,
        type=m.type,
        mode=m.mode,
        modes=tuple(st.ModeInfo(x.name, tuple(x.modules), tuple(x.registers), tuple(x.overlays)) for x in m.modes),
        registers=tuple(_register_from_pb(r) for r in m.registers),
        interrupts=tuple(st.InterruptInfo(i.name, i.doc, i.count) for i in m.interrupts),
        streams=tuple(stream_from_pb(s) for s in m.streams),
        names=tuple(m.names),
        schema=m.schema,
        memories=tuple(memory_from_pb(x) for x in m.memories),
        entries=tuple(
            st.ConfigEntry(e.name, e.type, tuple(e.modes), e.default_mode, e.origin, e.owner, e.bytes)
            for e in m.entries
        ),
    )


def _register_to_pb(r: st.RegisterInfo) -> pb.RegisterInfo:
    return pb.RegisterInfo(
        name=r.name,
        address=r.address,
        width=r.width,
        access=r.access,
        default=r.default,
        minimum=r.minimum,
        maximum=r.maximum,
        doc=r.doc,
        fields=[_field_to_pb(f) for f in r.fields],
        modes=r.modes,
        region=r.region,
    )


def _field_to_pb(f: st.FieldInfo) -> pb.FieldInfo:
    values = [pb.FieldValue(name=name, value=value) for name, value in f.values]
    return pb.FieldInfo(name=f.name, lsb=f.lsb, width=f.width, doc=f.doc, values=values, access=f.access)


def _field_from_pb(m: pb.FieldInfo) -> st.FieldInfo:
    return st.FieldInfo(m.name, m.lsb, m.width, m.doc, tuple((v.name, v.value) for v in m.values), m.access)


def _register_from_pb(m: pb.RegisterInfo) -> st.RegisterInfo:
    return st.RegisterInfo(
        m.name,
        m.address,
        m.width,
        m.access,
        m.default if m.HasField("default") else None,
        m.minimum if m.HasField("minimum") else None,
        m.maximum if m.HasField("maximum") else None,
        m.doc,
        tuple(_field_from_pb(f) for f in m.fields),
        tuple(m.modes),
        m.region,
    )


def memory_to_pb(x: st.MemoryInfo) -> pb.MemoryInfo:
    return pb.MemoryInfo(
        name=x.name,
        address=x.address,
        size=x.size,
        access=x.access,
        dtype=x.dtype,
        shape=x.shape,
        region=x.region,
        doc=x.doc,
        modes=x.modes,
        defined=x.defined,
    )


def memory_from_pb(m: pb.MemoryInfo) -> st.MemoryInfo:
    return st.MemoryInfo(
        m.name, m.address, m.size, m.access, m.dtype, tuple(m.shape), m.region, m.doc, tuple(m.modes), m.defined
    )


def plan_to_pb(p: st.PlanInfo) -> pb.Plan:
    steps = [
        pb.PlanStep(kind=s.kind, subject=s.subject, text=s.text, bytes=s.bytes, seconds=s.seconds) for s in p.steps
    ]
    plan = pb.Plan(config_name=p.config_name, mode=p.mode, steps=steps, bytes=p.bytes, seconds=p.seconds)
    plan.clocks.extend(_clocks_to_pb(p.clocks))
    return plan


def plan_from_pb(m: pb.Plan) -> st.PlanInfo:
    steps = tuple(st.PlanStep(s.kind, s.subject, s.text, s.bytes, s.seconds) for s in m.steps)
    return st.PlanInfo(m.config_name, m.mode, steps, m.bytes, m.seconds, _clocks_from_pb(m.clocks))


def change_to_pb(c: st.ChangeInfo) -> pb.Change:
    return pb.Change(number=c.number, done=c.done, seconds=c.seconds, generation=c.generation)


def change_from_pb(m: pb.Change) -> st.ChangeInfo:
    return st.ChangeInfo(m.number, m.done, m.seconds, m.generation)


def lease_to_pb(x: st.LeaseInfo) -> pb.Lease:
    return pb.Lease(id=x.id, scope=x.scope, exclusive=x.exclusive, seconds=x.seconds, holder=x.holder)


def lease_from_pb(m: pb.Lease) -> st.LeaseInfo:
    return st.LeaseInfo(m.id, m.scope, m.exclusive, m.seconds, m.holder)


def frame_to_pb(f: st.FrameInfo) -> pb.Frame:
    return pb.Frame(
        stream=f.stream,
        sequence=f.sequence,
        timestamp_ns=f.timestamp_ns,
        length=f.length,
        shape=f.shape,
        dtype=f.dtype,
        config_name=f.config_name,
        mode=f.mode,
        compression=f.compression,
        offset=f.offset,
        generation=f.generation,
        format=f.format,
    )


def frame_from_pb(m: pb.Frame) -> st.FrameInfo:
    return st.FrameInfo(
        m.stream,
        m.sequence,
        m.timestamp_ns,
        m.length,
        tuple(m.shape),
        m.dtype,
        m.config_name,
        m.mode,
        m.compression,
        m.offset,
        m.generation,
        m.format,
    )


def irq_to_pb(i: st.Irq) -> pb.Irq:
    return pb.Irq(name=i.name, count=i.count, timestamp_ns=i.timestamp_ns)


def irq_from_pb(m: pb.Irq) -> st.Irq:
    return st.Irq(m.name, m.count, m.timestamp_ns)
