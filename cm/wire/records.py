# SPDX-License-Identifier: Apache-2.0
"""Messages that only records have (`cm.recording.layout`), and what describes all messages to readers without us."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire import protobuf_messages
from cm.wire.messages.status import FrameInfo

LOST = ("disk_full", "disk_error", "too_slow", "manager_gone", "recorder_ended", "damaged")  # Gap.cause


def descriptor_set() -> bytes:
    """`cm.proto`, compiled: the schema of each of its messages in MCAP. It imports nothing."""
    described = FileDescriptorSet()
    pb.DESCRIPTOR.CopyToProto(described.file.add())
    return described.SerializeToString()


def encode_clock(monotonic_ns: int, realtime_ns: int) -> bytes:
    """A Clock."""
    return pb.Clock(monotonic_ns=monotonic_ns, realtime_ns=realtime_ns).SerializeToString()


def encode_gap(gap: Gap) -> bytes:
    """A Gap."""
    assert gap.cause in LOST, gap.cause
    return pb.Gap(**gap._asdict()).SerializeToString()


def encode_frame_seen(info: FrameInfo, kept: bool, sha256: bytes) -> bytes:
    """A FrameSeen."""
    return pb.FrameSeen(frame=protobuf_messages.FRAME.to_pb(info), kept=kept, sha256=sha256).SerializeToString()


def begin_bytes(number: int, length: int) -> bytes:
    """What stands before the bytes of a field of this number (15 at most): they need no second copy."""
    out = bytearray([number << 3 | 2])
    while length > 0x7F:
        out.append(length & 0x7F | 0x80)
        length >>= 7
    out.append(length)
    return bytes(out)


# ---- read ------------------------------------------------------------------------------------


class Clock(NamedTuple):
    """What both clocks of the manager's machine said at one moment."""

    monotonic_ns: int
    realtime_ns: int


class Gap(NamedTuple):
    """What is missing of a topic (empty: of all), and why; times are the record's. 0 messages or bytes: not known."""

    topic: str
    from_ns: int
    until_ns: int
    messages: int = 0
    bytes: int = 0
    cause: str = ""
    text: str = ""


class FrameSeen(NamedTuple):
    """A frame that came; its data follow where they were kept."""

    frame: FrameInfo
    kept: bool = False
    sha256: bytes = b""


_OURS: Mapping[str, tuple[Any, Callable[[Any], Any]]] = {
    "Status": (pb.Status, protobuf_messages.STATUS.from_pb),
    "Config": (pb.Config, protobuf_messages.CONFIG.from_pb),
    "RegValues": (pb.RegValues, protobuf_messages.registers_from_pb),
    "Irq": (pb.Irq, protobuf_messages.IRQ.from_pb),
    "Audit": (pb.Audit, protobuf_messages.AUDIT.from_pb),
    "Clock": (pb.Clock, lambda m: Clock(m.monotonic_ns, m.realtime_ns)),
    "Gap": (pb.Gap, lambda m: Gap(*[getattr(m, name) for name in Gap._fields])),
    "FrameSeen": (pb.FrameSeen, lambda m: FrameSeen(protobuf_messages.FRAME.from_pb(m.frame), m.kept, m.sha256)),
    "FrameData": (pb.FrameData, lambda m: m.data),
}


def decode_recorded(schema: str, described: bytes, message: bytes) -> Any:
    """A message of a record; `schema`: its full name, `described`: the FileDescriptorSet that stands in the record.

    Ours become data; of all others, which hold a frame, the bytes in their field ``data``. Raises InvalidRequest.
    """
    package, _, name = schema.rpartition(".")
    if package == "cm" and name in _OURS:
        kind, read = _OURS[name]
    else:
        kind, read = _kind(schema, described), lambda m: bytes(m.data)
    try:
        return read(kind.FromString(message))
    except (DecodeError, AttributeError) as error:
        raise InvalidRequest(f"this is no {schema}: {error}") from None


@lru_cache(32)
def _kind(schema: str, described: bytes) -> Any:
    """The class of another's message. Raises InvalidRequest."""
    try:
        pool = descriptor_pool.DescriptorPool()
        for file in FileDescriptorSet.FromString(described).file:
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema))
    except (DecodeError, KeyError, TypeError) as error:
        raise InvalidRequest(f"the record does not describe {schema}: {error}") from None
