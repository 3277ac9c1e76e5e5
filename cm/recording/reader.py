# SPDX-License-Identifier: Apache-2.0
"""Records, read from the front: so one whose recorder was killed, or whose disk was full, is read as far as it goes.

What is damaged (`cm.recording.salvage`) becomes a `Gap` of cause ``damaged``, and the chunks behind it are read on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from heapq import heappop, heappush
from pathlib import Path
from typing import Any, NamedTuple

from cm.errors import InvalidRequest
from cm.extras import installing
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
    return InvalidRequest(f"records need the Python module {error.name}: {installing('record')}")


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
            lost: list[str] = []
            for record in _records(file, lost.append):
                for text in lost:
                    yield self._gap(file, text, last)
                lost.clear()
                if type(record).__name__ != "Described":
                    continue
                message, channel, schema = record
                if channel is None or schema is None:
                    yield self._gap(file, "the channel of a message is lost with an earlier chunk", last)
                    continue
                last = max(last, message.log_time)
                if channel.topic != GAP and not wanted(channel.topic):
                    continue
                try:
                    value = decode_recorded(schema.name, schema.data, message.data)
                except InvalidRequest as error:
                    yield self._gap(file, f"{channel.topic}: {error}", last)
                else:
                    yield Event(message.log_time, channel.topic, value)
            for text in lost:
                yield self._gap(file, text, last)

    def _gap(self, file: Path, text: str, at: int) -> Event:
        sentence = f"{file.name}: {text}"
        if sentence not in self.problems:
            self.problems.append(sentence)
        return Event(at, GAP, Gap("", at, at, cause="damaged", text=sentence))


def _records(file: Path, lost: Callable[[str], object]) -> Iterator[Any]:
    """What is whole of a file; `lost` is told in words what cannot be read."""
    try:
        from cm.recording.salvage import described
    except ModuleNotFoundError as error:
        raise needs_mcap(error) from None
    return described(file, lost)
