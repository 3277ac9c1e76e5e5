# SPDX-License-Identifier: Apache-2.0
"""Records, read from the front: so one whose recorder was killed, or whose disk was full, is read as far as it goes.

What is damaged (`cm.recording.salvage`) becomes a `Gap` of cause ``damaged``, and the chunks behind it are read on.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from heapq import heappop, heappush
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from cm.errors import InvalidRequest
from cm.extras import installing
from cm.recording.layout import FRAME_PREFIX, GAP, METADATA, STREAM_PREFIX, Opened, files_of, opened
from cm.wire.messages.status import FrameInfo
from cm.wire.records import Gap, decode_recorded

_HORIZON = 2_000_000_000  # nanoseconds by which a message may stand behind a later one
Wanted = Callable[[str], bool]


class Event(NamedTuple):
    """What a record tells on a topic, at this time of the record; the value is as `decode_recorded` gives it."""

    time_ns: int
    topic: str
    value: Any


class _Place(NamedTuple):
    """Where a message is, so that it can be read again alone."""

    time_ns: int
    file: Path
    at: int
    channel: int
    schema: Any


def needs_mcap(error: ModuleNotFoundError) -> InvalidRequest:
    """What to say where the library is missing."""
    return InvalidRequest(f"records need the Python module {error.name}: {installing('record')}")


class Record:
    """The files of a record. `opened`: what the first of them says; `problems`: sentences on what could not be read."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidRequest for what is no record of ours."""
        self.files = files_of(path)
        self.problems: list[str] = []
        self._salvage = _salvage()
        self._places: dict[str, list[_Place]] = {}  # of frames and their data, by topic, in the order of their times
        self.opened = self._opened()

    def _opened(self) -> Opened:
        for file in self.files:
            metadata = self._salvage.metadata_of(file, METADATA)
            if metadata is not None:
                try:
                    return opened(metadata)
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

    def frame(self, stream: str, until_ns: int) -> tuple[FrameInfo, bytes] | None:
        """The last frame of a stream by then whose data are here, read by its place: `events` has been at the end."""
        seen, kept = (self._places.get(prefix + stream, []) for prefix in (FRAME_PREFIX, STREAM_PREFIX))
        for number in range(_behind(kept, until_ns) - 1, -1, -1):
            place = kept[number]
            about = _behind(seen, place.time_ns) - 1
            if about >= 0 and seen[about].time_ns == place.time_ns:
                info, data = self._read(seen[about]), self._read(place)
                if info is not None and data is not None:
                    return info.frame, data
        return None

    def _read(self, place: _Place) -> Any:
        for message in self._salvage.messages_at(place.file, place.at):
            if message.channel_id == place.channel and message.log_time == place.time_ns:
                return decode_recorded(place.schema.name, place.schema.data, message.data)
        return None

    def _unordered(self, wanted: Wanted) -> Iterator[Event]:
        self.problems.clear()
        places: defaultdict[str, list[_Place]] = defaultdict(list)
        last = self.opened.started_ns
        for file in self.files:
            lost: list[str] = []
            for message, channel, schema, at in self._salvage.messages(file, lost.append):
                for text in lost:
                    yield self._gap(file, text, last)
                lost.clear()
                if channel is None or schema is None:
                    yield self._gap(file, "the channel of a message is lost with an earlier chunk", last)
                    continue
                last = max(last, message.log_time)
                if channel.topic.startswith((FRAME_PREFIX, STREAM_PREFIX)):
                    places[channel.topic].append(_Place(message.log_time, file, at, channel.id, schema))
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
        for found in places.values():
            found.sort(key=lambda place: place.time_ns)
        self._places = dict(places)

    def _gap(self, file: Path, text: str, at: int) -> Event:
        sentence = f"{file.name}: {text}"
        if sentence not in self.problems:
            self.problems.append(sentence)
        return Event(at, GAP, Gap("", at, at, cause="damaged", text=sentence))


def _behind(places: list[_Place], time_ns: int) -> int:
    """How many are not later."""
    return bisect_right(places, time_ns, key=lambda place: place.time_ns)


def _salvage() -> ModuleType:
    """What reads files; who asks a manager does without it."""
    try:
        from cm.recording import salvage
    except ModuleNotFoundError as error:
        raise needs_mcap(error) from None
    return salvage
