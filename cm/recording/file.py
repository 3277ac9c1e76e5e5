# SPDX-License-Identifier: Apache-2.0
"""One file of a record: MCAP's records as the library `mcap` has them, but for chunks and messages.

The library's own writer copies a frame five times. Here a chunk is written in one call from where its parts lie, with
its length and its CRC, so a frame is copied by the kernel alone, and a kill leaves a chunk whole or not at all.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Union

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from cm._version import __version__
from cm.frozen import dataclass
from cm.recording.layout import METADATA, Opened

try:
    from isal.isal_zlib import crc32  # a tenth of the time, by instructions that Debian's zlib does not use
except ModuleNotFoundError:
    from zlib import crc32

_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_CHUNK = struct.Struct("<BQQQQIIQ")  # …, times of its first and last message, length, CRC, no compression, length
_MESSAGE = struct.Struct("<BQHIQQ")  # …, channel, sequence, log_time, publish_time
_ENOUGH = 1 << 20  # bytes that wait for a chunk
_LARGE = 1 << 16  # bytes of a message that are not copied, but written at once, with what waits

Data = Union[bytes, "tuple[bytes | memoryview, ...]"]  # a message, or its parts


@dataclass(frozen=True, slots=True)
class Schema:
    """What a channel's messages are."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic whose messages are of one schema."""

    number: int
    topic: str
    schema: Schema
    encoding: str
    metadata: Mapping[str, str]


class Channels:
    """Channels by topic and schema, the same in all files of a record."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], Channel] = {}

    def of(self, topic: str, schema: Schema, encoding: str = "protobuf", **metadata: str) -> Channel:
        """The channel of a topic, made when it is first asked for."""
        known = self._known.get((topic, schema.name))
        if known is None:
            known = Channel(len(self._known) + 1, topic, schema, encoding, metadata)
            self._known[topic, schema.name] = known
        return known


class RecordFile:
    """A file that grows. One thread at a time; `sync` beside it.

    `length`: bytes that are whole in it; `problem`: why the disk takes no more. From then on what comes is swallowed.
    """

    def __init__(self, path: Path, opened: Opened, profile: str = "") -> None:
        """Raises OSError, also if there is such a file."""
        self.path, self.opened = path, opened
        self.length = 0
        self.problem: OSError | None = None
        self.waiting = self.waiting_bytes = 0  # messages that are in no chunk on disk yet
        self.waiting_since = 0  # time of the first of them
        self._chunk = bytearray()
        self._within: dict[int, list[tuple[int, int]]] = {}  # by channel: times of the chunk's messages, and where
        self._schemas: dict[str, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._counts: Counter[int] = Counter()  # messages by channel
        self._chunks: list[records.ChunkIndex] = []
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        self._fd = os.open(path, flags, 0o644)
        head = RecordBuilder()
        head.write(MCAP0_MAGIC)
        records.Header(profile=profile, library=f"fpga-cm {__version__}").write(head)
        begin = head.count
        records.Metadata(METADATA, opened.strings()).write(head)
        self._metadata = records.MetadataIndex(begin, head.count - begin, METADATA)
        self._write(_made(head))

    def log(self, channel: Channel, data: Data, time_ns: int) -> None:
        """A message; look at `problem` then. Raises ValueError for a time that is none, and changes nothing."""
        parts = data if isinstance(data, tuple) else (data,)
        length = sum(map(len, parts))
        number, sequence = channel.number, self._counts[channel.number] & 0xFFFFFFFF
        try:
            head = _MESSAGE.pack(
                Opcode.MESSAGE, _MESSAGE.size - _HEAD.size + length, number, sequence, time_ns, time_ns
            )
        except struct.error as error:
            raise ValueError(f"{time_ns} is no time: {error}") from None
        if number not in self._channels:
            self._describe(channel)
        self._counts[number] += 1
        self._within.setdefault(number, []).append((time_ns, len(self._chunk)))
        self.waiting_since = self.waiting_since if self.waiting else time_ns
        self.waiting += 1
        self.waiting_bytes += length
        self._chunk += head
        if length >= _LARGE:
            self._settle(parts)
        else:
            for part in parts:
                self._chunk += part
            if len(self._chunk) >= _ENOUGH:
                self._settle()

    def flush(self) -> None:
        """Write what waits; look at `problem` then."""
        if self._within:
            self._settle()

    def sync(self) -> None:
        """Wait until the disk has what was written, so that it outlives a loss of power too. Beside all else."""
        if self.problem is None:
            try:
                os.fdatasync(self._fd)
            except OSError as error:
                self.problem = error

    def close(self) -> None:
        """End it, with its summary; look at `problem` then."""
        self.flush()
        self._end()
        os.close(self._fd)

    # ---- its parts -----------------------------------------------------------------------

    def _describe(self, channel: Channel) -> None:
        """Into the chunk, before its first message."""
        described, made = channel.schema, RecordBuilder()
        schema = self._schemas.get(described.name)
        if schema is None:
            number = len(self._schemas) + 1
            schema = records.Schema(id=number, name=described.name, encoding=described.encoding, data=described.data)
            self._schemas[described.name] = schema
            schema.write(made)
        known = records.Channel(channel.number, channel.topic, channel.encoding, dict(channel.metadata), schema.id)
        self._channels[channel.number] = known
        known.write(made)
        self._chunk += _made(made)

    def _settle(self, parts: tuple[bytes | memoryview, ...] = ()) -> None:
        """What waits is a chunk, the data of its last message being in `parts`."""
        length, crc = len(self._chunk), crc32(self._chunk)
        for part in parts:
            length += len(part)
            crc = crc32(part, crc)
        times = [time_ns for told in self._within.values() for time_ns, _ in told]
        first, last, size = min(times), max(times), _CHUNK.size + length
        head = _CHUNK.pack(Opcode.CHUNK, size - _HEAD.size, first, last, length, crc, 0, length)
        index, places = RecordBuilder(), {}
        for number, told in self._within.items():
            places[number] = self.length + size + index.count
            records.MessageIndex(number, told).write(index)
        behind = _made(index)
        known = records.ChunkIndex(
            chunk_length=size, chunk_start_offset=self.length, compression="", compressed_size=length,
            message_end_time=last, message_index_length=len(behind), message_index_offsets=places,
            message_start_time=first, uncompressed_size=length,
        )  # fmt: skip
        if self._write(head, self._chunk, *parts, behind):
            self._chunks.append(known)
            self.waiting = self.waiting_bytes = 0
        else:  # it is told of, and not in the summary
            for number, told in self._within.items():
                self._counts[number] -= len(told)
        self._chunk, self._within = bytearray(), {}

    def _end(self) -> None:
        """The summary: even of a file that the disk had no more room for, if it has for that."""
        self.problem, problem = None, self.problem
        made, counts = RecordBuilder(), {number: count for number, count in self._counts.items() if count}
        records.DataEnd(0).write(made)
        begin = made.count
        for record in (*self._schemas.values(), *self._channels.values(), *self._chunks, self._metadata):
            record.write(made)
        records.Statistics(
            attachment_count=0, channel_count=len(self._channels), channel_message_counts=counts,
            chunk_count=len(self._chunks), message_count=sum(counts.values()), metadata_count=1,
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            schema_count=len(self._schemas),
        ).write(made)  # fmt: skip
        data = _made(made)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, self.length + begin, 0)
        crc = struct.pack("<I", crc32(footer, crc32(data[begin:])))
        self._write(data, footer, crc, MCAP0_MAGIC)
        self.problem = problem or self.problem

    def _write(self, *parts: bytes | bytearray | memoryview) -> bool:
        """All of it, or nothing."""
        rest = [memoryview(part) for part in parts if len(part)]
        total = sum(map(len, rest))
        while rest and self.problem is None:
            try:
                taken = os.writev(self._fd, rest)
            except OSError as error:
                self.problem = error
                with suppress(OSError):  # a reader finds that it ends within a record
                    os.ftruncate(self._fd, self.length)
                break
            while rest and taken >= len(rest[0]):
                taken -= len(rest.pop(0))
            if taken:
                rest[0] = rest[0][taken:]
        if rest:
            return False
        self.length += total
        return True


def _made(records: Any) -> bytes:
    """What a builder of the library has; its types are not told."""
    return bytes(records.end())
