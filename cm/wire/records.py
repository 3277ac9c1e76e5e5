# SPDX-License-Identifier: Apache-2.0
"""Messages that only records have (`cm.recording.layout`), and what describes all messages to readers without us."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from google.protobuf import descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire.messages.status import Clock as Clock
from cm.wire.messages.status import FrameInfo
from cm.wire.messages.status import Gap as Gap
from cm.wire.protobuf_messages import CODECS, kind_of, twin

FRAME = twin(FrameInfo)


def descriptor_set() -> bytes:
    """`cm.proto`, compiled: the schema of each of its messages in MCAP. It imports nothing."""
    described = FileDescriptorSet()
    pb.DESCRIPTOR.CopyToProto(described.file.add())
    return described.SerializeToString()


def encode_frame_seen(info: FrameInfo, kept: bool, sha256: bytes) -> bytes:
    """A FrameSeen."""
    return pb.FrameSeen(frame=FRAME.to_pb(info), kept=kept, sha256=sha256).SerializeToString()


def begin_bytes(number: int, length: int) -> bytes:
    """What stands before the bytes of a field of this number (15 at most): they need no second copy."""
    out = bytearray([number << 3 | 2])
    while length > 0x7F:
        out.append(length & 0x7F | 0x80)
        length >>= 7
    out.append(length)
    return bytes(out)


# ---- pictures that Foxglove shows ------------------------------------------------------------

RAW_IMAGE = "foxglove.RawImage"
_FIELDS = (("width", 2), ("height", 3), ("encoding", 4), ("step", 5), ("data", 6), ("frame_id", 7))


@lru_cache(1)
def raw_image_set() -> bytes:
    """The schema of `RAW_IMAGE`, as Foxglove's own recorders describe it."""
    types = {"encoding": FieldDescriptorProto.TYPE_STRING, "data": FieldDescriptorProto.TYPE_BYTES,
             "frame_id": FieldDescriptorProto.TYPE_STRING}  # fmt: skip
    image = FileDescriptorProto(name="foxglove/RawImage.proto", package="foxglove", syntax="proto3")
    image.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    message = image.message_type.add(name="RawImage")
    stamp = FieldDescriptorProto.TYPE_MESSAGE
    message.field.add(name="timestamp", number=1, label=1, type=stamp, type_name=".google.protobuf.Timestamp")
    for name, number in _FIELDS:
        message.field.add(name=name, number=number, label=1, type=types.get(name, FieldDescriptorProto.TYPE_FIXED32))
    described = FileDescriptorSet()
    timestamp_pb2.DESCRIPTOR.CopyToProto(described.file.add())
    described.file.append(image)
    return described.SerializeToString()


def encode_raw_image(time_ns: int, **fields: Any) -> bytes:
    """A picture, all of it or all but its data; the fields are named as Foxglove does."""
    image = _kind(RAW_IMAGE, raw_image_set())(**fields)
    image.timestamp.seconds, image.timestamp.nanos = divmod(time_ns, 10**9)
    return bytes(image.SerializeToString())


# ---- read ------------------------------------------------------------------------------------


class FrameSeen(NamedTuple):
    """A frame that came; its data follow where they were kept."""

    frame: FrameInfo
    kept: bool = False
    sha256: bytes = b""


_OURS: Mapping[str, tuple[Any, Callable[[Any], Any]]] = {
    **{
        name: (getattr(pb, name), CODECS[kind_of(name)].from_pb)
        for name in ("Status", "Config", "RegValues", "Irq", "Audit", "Clock", "Gap")
    },
    "FrameSeen": (pb.FrameSeen, lambda m: FrameSeen(FRAME.from_pb(m.frame), m.kept, m.sha256)),
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
