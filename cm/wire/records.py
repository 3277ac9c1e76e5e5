# SPDX-License-Identifier: Apache-2.0
"""Messages that only records have (`cm.recording.layout`), and what describes all messages to readers without us."""

from __future__ import annotations

from google.protobuf.descriptor_pb2 import FileDescriptorSet

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


def encode_gap(topic: str, times: tuple[int, int], cause: str, text: str, messages: int = 0, length: int = 0) -> bytes:
    """A Gap; `times`: from and until, in the record's time; `length` in bytes."""
    assert cause in LOST, cause
    begin, end = times
    gap = pb.Gap(topic=topic, from_ns=begin, until_ns=end, messages=messages, bytes=length, cause=cause, text=text)
    return gap.SerializeToString()


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
