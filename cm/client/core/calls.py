# SPDX-License-Identifier: Apache-2.0
"""Requests of a client and what the replies mean, without sockets: shared by `board` and `aio`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, SupportsIndex, TypeVar

from cm.client.core.value_checks import register_value, register_write
from cm.client.errors import request_error
from cm.errors import InvalidRequest
from cm.frozen import dataclass
from cm.wire.lazy_numpy import np
from cm.wire.messages import requests as rq
from cm.wire.messages.status import (
    ChangeInfo,
    ClientStatus,
    ConfigEntry,
    ConfigInfo,
    FrameInfo,
    Irq,
    LeaseInfo,
    MemoryInfo,
    PlanInfo,
    RegionCheck,
    RegionMap,
    RegValues,
    Reply,
    Status,
    StreamStatus,
    UploadInfo,
)

if TYPE_CHECKING:
    from cm.client.frame import Frame

_T = TypeVar("_T")
Value = SupportsIndex | str  # an integer, numpy's too, or the name of a field's value
Writes = Mapping[str, Value] | Iterable[tuple[str, Value]]  # in their order


@dataclass(frozen=True, slots=True)
class Call(Generic[_T]):
    """A request, and how its reply becomes a result."""

    request: rq.Request
    result: Callable[[Reply], _T]


def _body(reply: Reply, kind: type[_T]) -> _T:
    if reply.error is not None:
        raise request_error(reply.error)
    if not isinstance(reply.body, kind):
        raise InvalidRequest(f"the manager answered with {type(reply.body).__name__}, not {kind.__name__}")
    return reply.body


def _whole(kind: type[_T]) -> Callable[[Reply], _T]:
    return partial(_body, kind=kind)


_STATUS = Call(rq.ReadStatus(), _whole(Status))
_REGISTERS = _whole(RegValues)


def status() -> Call[Status]:
    """The current status."""
    return _STATUS


def clients() -> Call[tuple[ClientStatus, ...]]:
    """What each client uses of the manager."""
    return Call(rq.ReadStatus(clients=True), lambda r: _body(r, Status).clients)


def history() -> Call[Status]:
    """The current status with the changes and writes that the manager remembers."""
    return Call(rq.ReadStatus(history=True), lambda r: _body(r, Status))


def config_names() -> Call[tuple[str, ...]]:
    """Names of all configurations."""
    return Call(rq.ListConfigs(), lambda r: _body(r, ConfigInfo).names)


def config_entries() -> Call[tuple[ConfigEntry, ...]]:
    """All configurations, with their modes and origins."""
    return Call(rq.ListConfigs(), lambda r: _body(r, ConfigInfo).entries)


def remove_config(name: str, lease: str) -> Call[tuple[ConfigEntry, ...]]:
    """Remove what a client sent; returns what is left."""
    return Call(rq.RemoveConfig(name, lease), lambda r: _body(r, ConfigInfo).entries)


def describe(name: str = "") -> Call[ConfigInfo]:
    """A configuration."""
    return Call(rq.ReadConfig(config_name=name), _whole(ConfigInfo))


def plan(mode: str = "", config: str = "", unload: str = "") -> Call[PlanInfo]:
    """What going to a mode would do."""
    return Call(rq.PlanChange(config, mode, unload), _whole(PlanInfo))


def load(
    config: str, mode: str, *, wait: bool, queue: bool, force: bool, lease: str, undoable: str = "", undo: str = ""
) -> Call[ChangeInfo]:
    """Go to a mode."""
    request = rq.ChangeMode(
        config,
        mode,
        name_or_mode="",
        no_wait=not wait,
        no_queue=not queue,
        force=force,
        lease=lease,
        undoable=undoable,
        undo=undo,
    )
    return Call(request, _whole(ChangeInfo))


def unload(region: str, lease: str) -> Call[ChangeInfo]:
    """Isolate a region, or all."""
    return Call(rq.ChangeMode(unload=region or rq.WHOLE, lease=lease), _whole(ChangeInfo))


def cancel() -> Call[Status]:
    """Cancel the running change."""
    return Call(rq.CancelChange(), _whole(Status))


def provision(schema: Path, files: tuple[Path, ...], lease: str) -> Call[ConfigInfo]:
    """Send a schema file and the files that belong to it."""
    sent = tuple(rq.File(path.name, path.read_bytes()) for path in files)
    try:
        text = schema.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InvalidRequest(
            f"{schema} is no runtime schema: it is not UTF-8 ({error.reason} at byte {error.start})"
        ) from None
    request = rq.Provision(text, sent, lease=lease)
    return Call(request, _whole(ConfigInfo))


def upload(part: rq.Upload) -> Call[UploadInfo]:
    """Send a part of data that is too long for one message."""
    return Call(part, _whole(UploadInfo))


def read_registers(names: tuple[str, ...]) -> Call[RegValues]:
    """Registers by name; all readable ones if none is named."""
    return Call(rq.ReadReg(names), _REGISTERS)


def write_registers(values: Writes, lease: str = "") -> Call[RegValues]:
    """Registers by name, in order, all checked before the first is written; a field's value may be named."""
    pairs = values.items() if isinstance(values, Mapping) else values
    try:
        writes = tuple([register_write(name, value) for name, value in pairs])
    except (TypeError, ValueError) as error:
        if isinstance(error, InvalidRequest):
            raise
        raise InvalidRequest(f"registers are written as {{name: value}}, or pairs of these, not {values!r}") from None
    return Call(rq.WriteReg(writes, lease), _REGISTERS)


def write_masked(name: str, value: int, mask: int, lease: str = "") -> Call[RegValues]:
    """The bits in `mask` of a register."""
    return Call(
        rq.WriteReg(
            (rq.RegWrite(name, register_value(name, value), mask=register_value(f"{name} (mask)", mask)),), lease
        ),
        _REGISTERS,
    )


def axes(stream: str, shape: Iterable[int]) -> tuple[int, ...]:
    """A stream's shape, as requests have it. Raises InvalidRequest for a number alone."""
    try:
        return tuple(shape)
    except TypeError:
        raise InvalidRequest(
            f"stream {stream!r}: shape={shape!r} is no shape: that has a length for each axis, as ({shape!r},)"
        ) from None


def configure_stream(request: rq.ConfigureStream) -> Call[StreamStatus]:
    """Configure a stream."""
    return Call(request, _whole(StreamStatus))


def describe_stream(name: str) -> Call[StreamStatus]:
    """A stream's settings and counters."""
    return Call(rq.DescribeData(name), _whole(StreamStatus))


def read_data(stream: str, timeout: float, raw: bool = False) -> Call[Frame]:
    """The next frame of a stream. `raw`: pixels as they lie in memory."""

    def result(reply: Reply) -> Frame:
        from cm.client.frame import frame_of  # imported here: it needs numpy

        info = _body(reply, FrameInfo)
        return frame_of(info, reply.payload[0] if reply.payload else b"", raw)

    return Call(rq.ReadData(stream, timeout), result)


def write_data(stream: str, data: Any, lease: str) -> Call[FrameInfo]:
    """Send a frame; the reply comes when the hardware has taken it."""
    plain = isinstance(data, (bytes, bytearray, memoryview)) or not isinstance(data, np.ndarray)
    try:
        view = memoryview(data if plain else np.ascontiguousarray(data).data).cast("B")
    except TypeError:
        raise InvalidRequest(f"stream {stream!r} takes an array or bytes, not {type(data).__name__}") from None
    picture = not plain and data.ndim == 3 and data.shape[2] == 3 and data.dtype == np.uint8
    return Call(rq.WriteData(stream, view, lease=lease, format="rgb" if picture else ""), _whole(FrameInfo))


def define_memory(request: rq.DefineMemory) -> Call[MemoryInfo]:
    """Define a memory."""
    return Call(request, _whole(MemoryInfo))


def describe_memory(name: str) -> Call[MemoryInfo]:
    """The description of a memory."""

    def result(reply: Reply) -> MemoryInfo:
        if isinstance(reply.body, StreamStatus):
            raise InvalidRequest(f"{name!r} is a stream, not a memory: board.stream({name!r})")
        return _body(reply, MemoryInfo)

    return Call(rq.DescribeData(name), result)


def read_memory(name: str, offset: int, length: int) -> Call[tuple[FrameInfo, Any]]:
    """Bytes of a memory, with their shape and dtype."""
    request = rq.ReadData(name, offset=offset, length=length)
    return Call(request, lambda r: (_body(r, FrameInfo), r.payload[0] if r.payload else b""))


def write_memory(name: str, offset: int, data: memoryview, lease: str) -> Call[FrameInfo]:
    """Write bytes to a memory; the reply comes when they have been written."""
    return Call(rq.WriteData(name, data, lease=lease, offset=offset), _whole(FrameInfo))


def check_region(name: str, repair: bool, reload: bool, lease: str) -> Call[RegionCheck]:
    """Compare a region's frames with what was loaded."""
    return Call(rq.CheckRegion(name, repair or reload, reload=reload, lease=lease), _whole(RegionCheck))


def map_region(name: str) -> Call[RegionMap]:
    """Count what was loaded into a region."""
    return Call(rq.MapRegion(name), _whole(RegionMap))


def interrupt(name: str) -> Call[Irq]:
    """Count and time of an interrupt."""
    return Call(rq.ReadIrq(name), _whole(Irq))


def lease(request: rq.TakeLease | rq.RenewLease | rq.ReleaseLease | rq.BreakLease) -> Call[LeaseInfo]:
    """Take, renew or give back a lease."""
    return Call(request, _whole(LeaseInfo))


def ended(status: Status, number: int) -> float:
    """The seconds that an ended change took, as the status says. Raises RequestFailed."""
    if status.last_change == number:
        if status.last_error is not None:
            raise request_error(status.last_error)
        return status.last_change_seconds
    return 0.0
