# SPDX-License-Identifier: Apache-2.0
"""A record as files that follow each other: when one ends and the next begins, and which are removed."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from cm.errors import InvalidRequest
from cm.frozen import dataclass, replace
from cm.recording.file import Channel, Channels, Data, RecordFile, Schema
from cm.recording.layout import DATA, FRAME, GAP, SCHEMAS, Opened, file_name, files_of, is_folder
from cm.wire.encode import encoded
from cm.wire.records import Gap, descriptor_set

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_ROOM = 32 << 20  # bytes that a full disk has free again before a record goes on
_AGAIN = 10.0  # seconds before a disk with another error is tried again
_PARTS = 8  # files of a ring; the oldest goes when the others hold what is wanted

Message = tuple[Channel, bytes]


def as_protobuf(record: Record, gap: Gap) -> Message:
    """A gap on `cm_gap`."""
    return record.channel(GAP), encoded(gap)


@dataclass(frozen=True, slots=True)
class Limits:
    """Of a file in bytes and seconds (`split`), and of all together (`ring`, whose oldest files go); 0: none."""

    split_bytes: int = 0
    split_seconds: float = 0.0
    ring_bytes: int = 0
    ring_seconds: float = 0.0

    @property
    def file_bytes(self) -> int:
        """At which a file ends."""
        return self.split_bytes or self.ring_bytes // _PARTS

    @property
    def file_seconds(self) -> float:
        """After which a file ends."""
        return self.split_seconds or self.ring_seconds / _PARTS

    @property
    def is_ring(self) -> bool:
        """Whether old files go."""
        return bool(self.ring_bytes or self.ring_seconds)


class Record:
    """Where messages go. Threads share it.

    Whatever the disk does, `log` returns: what it did not take is counted, and stands as a gap in the next file.
    """

    def __init__(
        self,
        place: Path,
        limits: Limits,
        opened: Opened,
        now: Callable[[], int],
        state: Callable[[Record], Iterable[Message]],
        told: Callable[[str], object] = lambda _: None,
        gap: Callable[[Record, Gap], Message] = as_protobuf,
        profile: str = "",
    ) -> None:
        """`now`: the record's time. `state`: what each file begins with. `told` gets sentences for people. `gap` makes
        the message of one, `profile` is MCAP's.

        Raises OSError, InvalidRequest.
        """
        self.channels = Channels()
        self.missing = 0  # messages that no file has, nor a gap
        self._place, self._limits, self._opened = place, limits, opened
        self._now, self._state, self._told = now, state, told
        self._gap, self._profile = gap, profile
        described = descriptor_set()
        self._schemas = {name: Schema(f"cm.{name}", "protobuf", described) for name in (*SCHEMAS.values(), FRAME, DATA)}
        self._lock = threading.RLock()
        self._file: RecordFile | None = None
        self._lost: tuple[str, int, int, int] | None = None  # cause, since when, messages, bytes
        self._again = self._end = 0.0
        self._held = -1  # a descriptor of the folder, locked
        self._ended: dict[Path, float] = {}  # when files of a ring did, CLOCK_MONOTONIC
        try:
            before = self._earlier()
            self._number = before[0]
            self._open()
        except (OSError, InvalidRequest) as error:
            self._leave()
            if not isinstance(error, FileExistsError):
                raise
            raise InvalidRequest(f"{error.filename} is there already: name another file, or remove it") from None
        if before[1]:
            self.tell(Gap("", before[1], now(), cause="recorder_ended", text="no recorder ran"))

    def _earlier(self) -> tuple[int, int]:
        """The number of the last file of this record, and when it ended (ns): a ring goes on."""
        if not is_folder(self._place):
            with suppress(InvalidRequest):  # there is no record
                there = files_of(self._place)[0]  # one that follows it would be in the way, and be read as part of it
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(there))
            return 0, 0
        self._place.mkdir(parents=True, exist_ok=True)
        self._held = os.open(self._place, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)  # two would take each other's names and files
        except BlockingIOError:
            raise InvalidRequest(f"another recorder writes into {self._place}: name another folder") from None
        found = [path for path in self._place.glob("*.mcap") if path.stem.isdecimal()]
        last = max(found, key=lambda path: int(path.stem), default=None)
        if last is not None and not self._limits.is_ring:
            raise InvalidRequest(f"{self._place} has a record already: name another folder, or remove it")
        return (int(last.stem), last.stat().st_mtime_ns) if last is not None else (0, 0)

    def channel(self, topic: str, schema: str = "") -> Channel:
        """The channel of a topic with messages of `cm.proto`."""
        with self._lock:
            return self.channels.of(topic, self._schemas[schema or SCHEMAS[topic]])

    @property
    def files(self) -> list[Path]:
        """Those that are there, in order."""
        return files_of(self._place)

    # ---- what is written -----------------------------------------------------------------

    def log(self, channel: Channel, data: Data, time_ns: int) -> None:
        """A message, at a time of the record. Raises ValueError for what is no time."""
        with self._lock:
            if self._file is None:
                self._miss(time_ns, 1, sum(map(len, data)) if isinstance(data, tuple) else len(data))
                return
            self._file.log(channel, data, time_ns)
            self._look()

    def tell(self, gap: Gap) -> None:
        """Something is missing."""
        self.log(*self._gap(self, gap), gap.until_ns)

    def _look(self) -> None:
        file, limits = self._file, self._limits
        if file is None:
            return
        if file.problem is not None:
            self._give_up(file, file.problem)
        elif (limits.file_bytes and file.length >= limits.file_bytes) or (self._end and time.monotonic() > self._end):
            self._close(file)
            if self._file is not None:
                try:
                    self._open()
                except OSError as error:
                    self._give_up(file, error, closed=True)

    def tick(self) -> None:
        """Once a second: what waits is written, a file that is old ends, a disk that was full is tried again."""
        with self._lock:
            if self._file is not None:
                self._file.flush()
                self._look()
            elif time.monotonic() >= self._again and self._has_room():
                self._try_again()
            file = self._file
        if file is not None:
            file.sync()

    def close(self) -> None:
        """End the record."""
        with self._lock:
            if self._file is None and self._has_room():
                self._try_again()
            if self._file is not None:
                self._close(self._file)
            self._file = None
            if self._lost is not None:
                self.missing = self._lost[2]
            self._leave()

    def _leave(self) -> None:
        if self._held >= 0:
            os.close(self._held)
            self._held = -1

    # ---- files ---------------------------------------------------------------------------

    def _open(self) -> None:
        """The next file, with the state of now. Raises OSError."""
        self._number += 1
        path = file_name(self._place, self._number)
        self._file = RecordFile(path, replace(self._opened, number=self._number), self._profile)
        self._end = time.monotonic() + self._limits.file_seconds if self._limits.file_seconds else 0.0
        for channel, data in self._state(self):
            self._file.log(channel, data, self._now())
        self._trim()

    def _close(self, file: RecordFile) -> None:
        file.close()
        if file.problem is not None:
            self._give_up(file, file.problem, closed=True)

    def _give_up(self, file: RecordFile, problem: OSError, closed: bool = False) -> None:
        """The disk takes no more: what waited is lost, and what comes until there is room again."""
        if not closed:
            file.close()
        self._file = None
        cause = "disk_full" if problem.errno in _FULL else "disk_error"
        self._lost = (cause, file.waiting_since if file.waiting else self._now(), 0, 0)
        self._miss(file.waiting_since, file.waiting, file.waiting_bytes)
        self._again = time.monotonic() + (0 if cause == "disk_full" else _AGAIN)
        where = problem.filename or file.path
        self._told(f"{where}: {problem.strerror}; what comes is counted until there is room again")
        if self._limits.is_ring and self._remove_oldest(file.path):
            self._try_again()

    def _miss(self, time_ns: int, messages: int, length: int) -> None:
        cause, since, before, bytes_before = self._lost or ("disk_error", time_ns, 0, 0)
        self._lost = (cause, since, before + messages, bytes_before + length)

    def _has_room(self) -> bool:
        try:
            found = os.statvfs(self._place if is_folder(self._place) else self._place.parent)
        except OSError:  # the folder is gone
            return False
        return found.f_bavail * found.f_frsize >= _ROOM

    def _try_again(self) -> None:
        lost, now = self._lost, self._now()
        assert lost is not None
        try:
            self._open()
        except OSError:
            self._again = time.monotonic() + _AGAIN
            return
        cause, since, messages, length = lost
        text = f"the disk took nothing for {(now - since) / 1e9:.1f} s"
        self._lost = None
        self.tell(Gap("", since, now, messages, length, cause, text))
        self._told(f"there is room again: {text}, {messages} messages ({length} bytes) are lost")

    # ---- the ring ------------------------------------------------------------------------

    def _trim(self) -> None:
        """Remove the oldest files as long as the others hold what is wanted."""
        limits = self._limits
        while limits.is_ring:
            (oldest, *others) = self.files
            found = {path: path.stat() for path in (oldest, *others)}
            total = sum(status.st_size for status in found.values())
            much = limits.ring_bytes and total + limits.file_bytes > limits.ring_bytes
            now, wall = time.monotonic(), time.time()
            for path in (oldest, *others)[:-1]:  # known as soon as it has ended: the wall clock may be set later
                self._ended.setdefault(path, now - max(0.0, wall - found[path].st_mtime))
            old = limits.ring_seconds and others and self._ended[oldest] < now - limits.ring_seconds
            if not others or not (much or old) or not self._remove_oldest(others[-1]):
                return

    def _remove_oldest(self, but: Path) -> bool:
        oldest = self.files[0]
        if oldest == but:
            return False
        oldest.unlink(missing_ok=True)
        self._ended.pop(oldest, None)
        return True
