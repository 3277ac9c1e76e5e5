# SPDX-License-Identifier: Apache-2.0
"""MCAP's records of a file that may be cut off or damaged: all that are whole, and a word on what is not.

Chunks have a CRC, and are believed only with it. What stands between them has none: a bit there may make a chunk look
like an index, which readers skip, or an index like a message. So only what `cm record` writes there is accepted, in its
exact form; for anything else the next chunk is searched.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from cm.errors import InvalidRequest

_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_CHUNK = struct.Struct("<QQQII")  # times of its first and last message, size, CRC, length of its compression's name
_INDEX = struct.Struct("<HI")  # channel and bytes that follow
_COMPRESSIONS = (b"", b"lz4", b"zstd")
_BROKEN = (McapError, struct.error, ValueError, EOFError, OverflowError, MemoryError)
_PART = 1 << 20  # bytes whose CRC is computed at a time
_CUT = "its recorder was killed, or its disk was full"
Lost = Callable[[str], object]


class Described(NamedTuple):
    """A message with its channel, None if that was in a chunk that is lost; the schema is None if there is none."""

    message: Message
    channel: Channel | None
    schema: Schema | None
    at: int  # where in the file the record begins that it is in: its chunk, or itself


def metadata_of(file: Path, name: str) -> dict[str, str] | None:
    """The first metadata of this name; None if none are there. Raises InvalidRequest for what cannot be read."""
    found = (r.metadata for r in described(file, lambda _: None) if isinstance(r, Metadata) and r.name == name)
    return next(found, None)


def messages(file: Path, lost: Lost) -> Iterator[Described]:
    """What `described` finds of these."""
    return (record for record in described(file, lost) if isinstance(record, Described))


def messages_at(file: Path, at: int) -> list[Message]:
    """Those of one record of a file that was read before, by `Described.at`."""
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        found: list[Message] = []
        with suppress(*_BROKEN):  # it has been damaged since
            found.extend(record for record in _Walk(data, lambda _: None).one(at) if isinstance(record, Message))
        return found


def described(file: Path, lost: Lost) -> Iterator[Header | Metadata | Described]:
    """Headers, metadata and messages in their order; `lost` is told in words what is missing.

    Raises InvalidRequest for a file that cannot be read.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for at, record in _records(file, lost):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            if record.channel_id not in channels:
                _from_summary(file, schemas, channels)
            channel = channels.get(record.channel_id)
            if channel is not None and channel.schema_id and channel.schema_id not in schemas:
                channel = None
            yield Described(record, channel, schemas.get(channel.schema_id) if channel is not None else None, at)
        else:
            yield record


def _records(file: Path, lost: Lost) -> Iterator[tuple[int, Any]]:
    """Headers, metadata, schemas, channels and messages in their order, each with where it, or its chunk, begins.

    Raises InvalidRequest for a file that cannot be read.
    """
    try:
        with file.open("rb") as stream:
            if not file.stat().st_size:
                lost(f"it is empty: {_CUT}")
                return
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield from _Walk(data, lost).records()
    except OSError as error:
        raise InvalidRequest(f"{file}: {error.strerror or error}") from error


def _from_summary(file: Path, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    """Add the channels that the end of a whole file says again, each with its schema."""
    with file.open("rb") as stream, suppress(McapError, struct.error, ValueError, OSError):
        summary = SeekingReader(stream, validate_crcs=True, record_size_limit=file.stat().st_size).get_summary()
        if summary is not None:
            schemas.update(summary.schemas | schemas)
            channels.update(summary.channels | channels)


class _Walk:
    """A way through a file, from record to record."""

    def __init__(self, data: mmap.mmap, lost: Lost) -> None:
        self._data, self._tell = data, lost
        self._told = False
        self._chunks = False  # there was one: what holds messages is in chunks

    def one(self, at: int) -> Iterator[Any]:
        """What the record holds that begins here."""
        end = self._end(at)
        return iter(()) if end is None else self._parts(at, end)

    def records(self) -> Iterator[tuple[int, Any]]:
        """All that are whole, with where each, or its chunk, begins."""
        data, at = self._data, len(MCAP0_MAGIC)
        if data[:at] != MCAP0_MAGIC:
            self._lost("its first bytes are not those of an MCAP file")
            at = 0
        while at < len(data):
            end = self._end(at)
            if end is None:
                again = self._next_chunk(at + 1)
                if again is None:
                    self._lost(f"it ends at byte {at} of {len(data)}: {_CUT}, or it is damaged there")
                    return
                self._lost(f"bytes {at} to {again} are damaged, and nothing of them is shown")
                at = again
                continue
            if data[at] == Opcode.DATA_END:
                self._check_all(at)
                return
            try:
                for record in self._parts(at, end):
                    yield at, record
            except _BROKEN as error:
                self._lost(f"the record at byte {at} is damaged, and nothing of it is shown ({_words(error)})")
            at = end
        self._lost(f"it has no end: {_CUT}")

    def _check_all(self, at: int) -> None:
        """The end says which CRC all before it has."""
        data, crc = self._data, 0
        (wanted,) = struct.unpack_from("<I", data, at + _HEAD.size)
        if not wanted or self._told:
            return
        for begin in range(0, at, _PART):
            crc = zlib.crc32(data[begin : min(begin + _PART, at)], crc)
        if crc != wanted:
            self._lost("something between its chunks is damaged, but every chunk is whole")

    def _lost(self, text: str) -> None:
        self._told = True
        self._tell(text)

    def _end(self, at: int) -> int | None:
        """Where the record ends that begins here; None if none does that could stand here."""
        data = self._data
        if at + _HEAD.size > len(data):
            return None
        opcode, length = _HEAD.unpack_from(data, at)
        begin, end = at + _HEAD.size, at + _HEAD.size + length
        if end > len(data):
            return None
        if opcode == Opcode.CHUNK:
            good = self._is_chunk(at)
        elif opcode == Opcode.MESSAGE_INDEX:
            good = length >= _INDEX.size and _INDEX.unpack_from(data, begin)[1] == length - _INDEX.size
        elif opcode == Opcode.DATA_END:
            good = length == 4
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            good = not self._chunks
        else:
            good = opcode in (Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT)
        return end if good else None

    def _is_chunk(self, at: int) -> bool:
        data = self._data
        begin = at + _HEAD.size
        if begin + _CHUNK.size + 8 > len(data):
            return False
        _, length = _HEAD.unpack_from(data, at)
        first, last, size, _, named = _CHUNK.unpack_from(data, begin)
        name = begin + _CHUNK.size
        if named > 4 or first > last or begin + length > len(data) or data[name : name + named] not in _COMPRESSIONS:
            return False
        (stored,) = struct.unpack_from("<Q", data, name + named)
        return bool(length == _CHUNK.size + named + 8 + stored and (named or stored == size))

    def _next_chunk(self, at: int) -> int | None:
        opcode = bytes([Opcode.CHUNK])
        while (at := self._data.find(opcode, at)) >= 0:
            if self._is_chunk(at):
                return at
            at += 1
        return None

    def _parts(self, at: int, end: int) -> Iterator[Any]:
        opcode, begin = self._data[at], at + _HEAD.size
        if opcode in (Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT):
            return
        stream = ReadDataStream(BytesIO(self._data[begin:end]))
        if opcode == Opcode.CHUNK:
            self._chunks = True
            yield from breakup_chunk(Chunk.read(stream), validate_crc=True)
        elif opcode == Opcode.MESSAGE:
            yield Message.read(stream, end - begin)
        else:
            kinds: dict[int, Any] = {
                Opcode.HEADER: Header,
                Opcode.METADATA: Metadata,
                Opcode.SCHEMA: Schema,
                Opcode.CHANNEL: Channel,
            }
            yield kinds[opcode].read(stream)


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
