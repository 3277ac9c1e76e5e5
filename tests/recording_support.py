# SPDX-License-Identifier: Apache-2.0
"""Records as tests want them: events with the times that a test says, written by mcap's own writer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2
from mcap.writer import CompressionType, Writer

from cm.recording import layout
from cm.recording.layout import Opened
from cm.wire import cm_pb2 as pb
from cm.wire.protobuf_messages import CODECS, kind_of

BEGAN = 1_700_000_000_000_000_000  # nanoseconds: the time of the record at which each begins
OFFSET = BEGAN - 1_000_000_000  # so that the machine's clock stands at one second then
OPENED = Opened("bench", 1, BEGAN, OFFSET, "0.1", BEGAN - 5_000_000_000, "tests")
_DATA = ("Status", "Config", "RegValues", "Irq", "Audit")


def described() -> bytes:
    """cm.proto, as a record holds it."""
    files = descriptor_pb2.FileDescriptorSet()
    pb.DESCRIPTOR.CopyToProto(files.file.add())
    return files.SerializeToString()


def schema_of(topic: str) -> str:
    """The message of a topic."""
    if topic.startswith(layout.FRAME_PREFIX):
        return layout.FRAME
    return layout.DATA if topic.startswith(layout.STREAM_PREFIX) else layout.SCHEMAS[topic]


def message_of(topic: str, value: Any) -> Any:
    """Data, or a message already, as a message."""
    kind = schema_of(topic)
    if kind in _DATA:
        return CODECS[kind_of(kind)].to_pb(value)
    if isinstance(value, bytes):
        return pb.FrameData(data=value)
    return value


def write_record(
    path: Path, events: Iterable[tuple[float, str, Any]], opened: Opened = OPENED, finish: bool = True, chunk: int = 1
) -> Path:
    """A record of events, each with its seconds since the beginning, its topic, and its data.

    `chunk`: bytes after which a chunk ends, so that by default each message has its own.
    """
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start(profile="", library="tests")
        writer.add_metadata(layout.METADATA, opened.strings())
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for number, (seconds, topic, value) in enumerate(events):
            kind = f"cm.{schema_of(topic)}"
            if kind not in schemas:
                schemas[kind] = writer.register_schema(kind, "protobuf", described())
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "protobuf", schemas[kind])
            at = BEGAN + round(seconds * 1e9)
            data = message_of(topic, value).SerializeToString()
            writer.add_message(channels[topic], at, data, publish_time=at, sequence=number)
        if finish:
            writer.finish()
    return path
