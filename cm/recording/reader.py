# SPDX-License-Identifier: Apache-2.0
"""Records, read from the front: so one whose recorder was killed, or whose disk was full, is read as far as it goes.

Each chunk is checked before anything in it is believed. What is damaged becomes a `Gap` of cause ``damaged``, and the
chunks behind it are read on. Where the order of the file itself is damaged, it ends there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from pathlib import Path
from typing import IO, Any, NamedTuple

from cm.errors import InvalidRequest
from cm.recording.layout import GAP, METADATA, Opened, files_of, opened
from cm.wire.records import Gap, decode_recorded

_HORIZON = 2_000_000_000  # nanoseconds by which a message may stand behind a later one
Wanted = Callable[[str], bool]


class Event(NamedTuple):
    """What a record tells on a topic, at this time of the record; the value is as `decode_recorded` gives it."""

    time_ns: int
    topic: str
    value: Any


def needs_mcap(error: ModuleNotFoundError) -> InvalidRequest:
    """What to say where the library is missing."""
    return InvalidRequest(f"records need the Python module {error.name}: pip install 'fpga-cm[record]'")


class Record:
    """The files of a record. `opened`: what the first of them says; `problems`: sentences on what could not be read."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidRequest for what is no record of ours."""
        self.files = files_of(path)
        self.problems: list[str] = []
        self.opened = self._opened()

    def _opened(self) -> Opened:
        for file in self.files:
            for record in _records(file, lambda _: None):
                if type(record).__name__ == "Metadata" and record.name == METADATA:
                    try:
                        return opened(record.metadata)
                    except InvalidRequest as error:
                        raise InvalidRequest(f"{file}: {error}") from None
        raise InvalidRequest(f"{self.files[0]}: it is no record of cm record, or its beginning is lost")

    def events(self, wanted: Wanted = lambda _: True) -> Iterator[Event]:
        """All events of the topics that are wanted, in the order of their times; gaps always."""
        waiting: list[tuple[int, int, Event]] = []
        newest = 0
        for number, event in enumerate(self._unordered(wanted)):
            heappush(waiting, (event.time_ns, number, event))
            newest = max(newest, event.time_ns)
            while waiting[0][0] <= newest - _HORIZON:
                yield heappop(waiting)[2]
        while waiting:
            yield heappop(waiting)[2]

    def _unordered(self, wanted: Wanted) -> Iterator[Event]:
        self.problems.clear()
        last = self.opened.started_ns
        for file in self.files:
            schemas: dict[int, Any] = {}
            channels: dict[int, Any] = {}
            lost: list[str] = []
            for record in _records(file, lost.append):
                for text in lost:
                    yield self._gap(file, text, last)
                lost.clear()
                kind = type(record).__name__
                if kind == "Schema":
                    schemas[record.id] = record
                elif kind == "Channel":
                    channels[record.id] = record
                elif kind == "Message":
                    if record.channel_id not in channels:  # its description was in a chunk that is lost
                        _from_summary(file, schemas, channels)
                    channel = channels.get(record.channel_id)
                    if channel is None or channel.schema_id not in schemas:
                        yield self._gap(file, "the channel of a message is lost with an earlier chunk", last)
                        continue
                    last = max(last, record.log_time)
                    if channel.topic != GAP and not wanted(channel.topic):
                        continue
                    try:
                        schema = schemas[channel.schema_id]
                        value = decode_recorded(schema.name, schema.data, record.data)
                    except InvalidRequest as error:
                        yield self._gap(file, f"{channel.topic}: {error}", last)
                    else:
                        yield Event(record.log_time, channel.topic, value)
            for text in lost:
                yield self._gap(file, text, last)

    def _gap(self, file: Path, text: str, at: int) -> Event:
        sentence = f"{file.name}: {text}"
        if sentence not in self.problems:
            self.problems.append(sentence)
        return Event(at, GAP, Gap("", at, at, cause="damaged", text=sentence))


def _records(file: Path, lost: Callable[[str], object]) -> Iterator[Any]:
    """MCAP's records of a file, those in whole chunks too; `lost` is told in words what cannot be read."""
    try:
        stream = file.open("rb")
    except OSError as error:
        raise InvalidRequest(f"{file}: {error.strerror or error}") from error
    with stream:
        yield from _read(stream, file, lost)


def _read(stream: IO[bytes], file: Path, lost: Callable[[str], object]) -> Iterator[Any]:
    try:
        from mcap.exceptions import McapError
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk
    except ModuleNotFoundError as error:
        raise needs_mcap(error) from None
    broken = (McapError, struct.error, ValueError, EOFError, OverflowError, MemoryError)
    size, told = file.stat().st_size, 0
    reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=max(size, 1))
    records = iter(reader.records)
    while True:
        at = stream.tell()
        try:
            record = next(records)
        except StopIteration:
            return
        except broken as error:
            if type(error).__name__ != "CRCValidationError":
                cut = stream.tell() >= size or type(error).__name__ == "RecordLengthLimitExceeded"
                why = "its recorder was killed, or its disk was full" if cut else f"it is damaged ({_words(error)})"
                lost(f"it ends at byte {at} of {size}: {why}")
            elif not told:  # the data as a whole, so what holds them together
                lost(f"something between its chunks is damaged, so some may be missing ({_words(error)})")
            return
        kind = type(record).__name__
        if kind == "DataEnd":  # what follows says again what stands before it
            return
        try:
            parts = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
        except broken as error:
            if stream.tell() >= size:
                lost(f"its last chunk, at byte {at}, is cut off: its recorder was killed, or its disk was full")
                return
            told += 1
            lost(f"the chunk at byte {at} is damaged, and nothing of it is shown ({_words(error)})")
            continue
        yield from parts


def _from_summary(file: Path, schemas: dict[int, Any], channels: dict[int, Any]) -> None:
    """Add what the end of a whole file says again: which messages its channels have."""
    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    with file.open("rb") as stream, suppress(McapError, struct.error, ValueError, OSError):
        summary = SeekingReader(stream, validate_crcs=True, record_size_limit=file.stat().st_size).get_summary()
        if summary is not None:
            for number, schema in summary.schemas.items():
                schemas.setdefault(number, schema)
            for number, channel in summary.channels.items():
                channels.setdefault(number, channel)


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
