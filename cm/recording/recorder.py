# SPDX-License-Identifier: Apache-2.0
"""What a manager tells, into a record: a client like any other, that waits for its manager as long as it takes.

Three kinds of threads, so that nobody waits for the disk: one takes publications off ZeroMQ as they come, one for each
stream takes its frames, and the caller's of `run` writes what has come, some times a second: who wakes for each takes
the processor from those that the manager has just answered. Only frames are written where they are taken: they lie in
DMA memory, of which so many are lent, and the manager drops what a slow reader has no room for.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np

from cm._version import __version__
from cm.client.board import Board
from cm.client.core import calls
from cm.client.frame import Frame
from cm.client.request_reply import Subscription
from cm.errors import CmError, Forbidden, Timeout
from cm.frozen import dataclass, replace
from cm.recording import layout, pictures
from cm.recording.record import Limits, Message, Record
from cm.wire import topics
from cm.wire.encode import decode_event, encode_status, encoded
from cm.wire.messages.status import Audit, ConfigInfo, Irq, RegValue, RegValues, Status, StreamStatus
from cm.wire.records import Clock, Gap, encode_frame_seen

_EACH = 1.0  # seconds between two clocks, between writing what waits, and between two tries to connect
_TOGETHER = 0.1  # seconds in which publications gather before they are written
_WAITING = 50_000  # publications that wait for the disk; more are lost, which is told
_SAME = 10**9  # ns that the clocks of one machine may seem to be apart, as they are read one after the other
_DEPTH = 8  # frames that may be lent to us at a time
ALL = "all"

_Came = tuple[int, list[bytes]]  # when (ns, this machine's CLOCK_MONOTONIC), and the message


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is recorded of frames: `streams` by name, or ``("all",)``: those that hold nothing up for a slow reader.

    Data of each `every`-th frame are kept, of none if it is 0; `hashed`: the SHA-256 of each instead.
    """

    streams: tuple[str, ...] = ()
    every: int = 1
    hashed: bool = False

    def has(self, stream: StreamStatus) -> bool:
        """Whether a stream is wanted."""
        if stream.direction != "s2mm":
            return False
        return stream.name in self.streams or (self.streams == (ALL,) and not stream.backpressure)


class Recorder:
    """`run` records, until `stop`."""

    def __init__(
        self,
        connect: Callable[[], Board],
        place: Path,
        limits: Limits,
        wanted: Wanted,
        told: Callable[[str], object] = lambda _: None,
    ) -> None:
        """`told` gets sentences for people, `place` is a file or a folder (`cm.recording.layout`)."""
        self._connect, self._place, self._limits, self._wanted, self._told = connect, place, limits, wanted, told
        self._stopped = threading.Event()
        self._came: deque[_Came | CmError] = deque()
        self._streams: dict[str, _StreamThread] = {}
        self._record: Record | None = None
        self._shift = 0  # this machine's CLOCK_MONOTONIC → time of the record
        self._opened: layout.Opened
        self._status: Status | None = None
        self._past = Status()  # the last one with its history
        self._config = ConfigInfo()
        self._values: dict[str, RegValue] = {}
        self._heard = 0  # when the manager was last (time of the record)
        self._gone = False
        self.overflown = 0  # publications that were lost here

    @property
    def files(self) -> list[Path]:
        """The files of the record, once there is one."""
        return self._record.files if self._record is not None else []

    def run(self) -> int:
        """Until `stop`; how many messages are lost without a gap in a file that says so.

        The first manager has to be there. Raises OSError and InvalidRequest where no record can be begun, and CmError
        of a manager that is not there or does not admit us.
        """
        try:
            while not self._stopped.is_set():
                try:
                    with self._connect() as board:
                        self._follow(board)
                except CmError as error:
                    if self._record is None or isinstance(error, Forbidden):
                        raise
                    self._lose(str(error))
                self._tick()
                self._stopped.wait(_EACH)
        finally:
            if self._record is not None:
                self._record.close()
        return self._record.missing if self._record is not None else 0

    def stop(self) -> None:
        """End `run`, from any thread or signal handler; twice is fine."""
        self._stopped.set()

    # ---- the manager ---------------------------------------------------------------------

    def _follow(self, board: Board) -> None:
        """As long as the manager is there. Raises CmError when it is not."""
        subscription = board.subscribe(topics.STATUS, topics.READ_REG, topics.IRQ, topics.AUDIT, depth=_WAITING)
        over = threading.Event()
        taking = threading.Thread(target=self._take, args=(subscription, over), name="publications", daemon=True)
        taking.start()
        try:
            self._begin(board, board.status)
            due = time.monotonic() + _EACH
            while not self._stopped.is_set():
                self._stopped.wait(max(0.0, min(_TOGETHER, due - time.monotonic())))
                self._write(board)
                if time.monotonic() >= due:
                    due += _EACH
                    self._tick()
                    self._know(board, board.status)
            self._write(board)  # what was told before the end is in the record
        finally:
            for stream in self._streams.values():
                stream.stop()
            over.set()
            taking.join()
            subscription.close()
            for stream in self._streams.values():
                stream.join()
            self._streams.clear()
            self._came = deque()

    def _take(self, subscription: Subscription, over: threading.Event) -> None:
        """Publications off ZeroMQ, in a thread of its own: they never wait in the manager for our disk."""
        came = self._came
        try:
            while not over.is_set():
                frames = subscription.receive(_EACH / 4)
                if frames is None:
                    continue
                if len(came) < _WAITING:
                    came.append((time.monotonic_ns(), frames))
                else:
                    self.overflown += 1
        except CmError as error:
            came.append(error)

    def _begin(self, board: Board, status: Status) -> None:
        """The manager is there, for the first time or again."""
        first = self._record is None
        self._past = board.ask(calls.history())
        if first:
            # On another machine its clock is not ours: there the record follows the wall clock of here.
            here = time.time_ns() - time.monotonic_ns()
            local = abs(here - status.realtime_offset_ns) < _SAME
            self._shift = status.realtime_offset_ns if local else here
            self._opened = layout.Opened(
                board=status.board,
                number=0,
                started_ns=self._now(),
                offset_ns=status.realtime_offset_ns,
                manager=status.version,
                manager_started_ns=status.started_ns,
                recorder=__version__,
            )
        self._look_up(board, status)
        if first:
            self._record = Record(self._place, self._limits, self._opened, self._now, self._state, self._told)
        else:
            assert self._record is not None
            self._gap("", self._heard, "manager_gone", "nothing was told by the manager")
            for channel, data in self._state(self._record):
                self._record.log(channel, data, self._now())
            self._told("the manager is back")
        self._gone = False

    def _know(self, board: Board, status: Status) -> None:
        """A status, asked for or told: it may be that of another manager, which began within the second."""
        known = self._status
        if known is not None and status.started_ns != known.started_ns:
            self._lose("another manager serves")
            self._begin(board, status)
        self._heard = self._now()

    def _look_up(self, board: Board, status: Status) -> None:
        """What a status does not say."""
        self._status = status
        self._config = board.config() if status.config_name else ConfigInfo()
        try:
            read = board.ask(calls.read_registers(())).values if status.config_name else ()
        except CmError:  # a region is being changed: what is written then is told
            read = ()
        self._values = {value.name: value for value in read}
        self._watch(board, status)

    def _lose(self, why: str) -> None:
        if not self._gone:
            self._gone = True
            self._told(why)

    # ---- what is written -----------------------------------------------------------------

    def _now(self) -> int:
        return time.monotonic_ns() + self._shift

    def _log(self, topic: str, data: bytes, time_ns: int) -> None:
        assert self._record is not None
        self._record.log(self._record.channel(topic), data, time_ns)

    def _gap(self, topic: str, since: int, cause: str, text: str, messages: int = 0) -> None:
        assert self._record is not None
        self._record.tell(Gap(topic, since, self._now(), messages, cause=cause, text=text))

    def _clock(self) -> bytes:
        return encoded(Clock(self._now() - self._opened.offset_ns, time.time_ns()))

    def _state(self, record: Record) -> Iterator[Message]:
        """What is true now, for the beginning of a file."""
        status = self._status
        assert status is not None
        yield record.channel(layout.CLOCK), self._clock()
        yield record.channel(layout.STATUS), self._with_past(status)
        yield record.channel(layout.CONFIG), encoded(self._config)
        values = RegValues(tuple(self._values.values()), status.config_name, status.mode)
        yield record.channel(layout.REGISTERS), encoded(values)

    def _with_past(self, status: Status) -> bytes:
        """A status with the history behind it. The answer's own status is of later, before those on their way."""
        return bytes(encode_status(replace(status, changes=self._past.changes, writes=self._past.writes))[1])

    def _tick(self) -> None:
        """Once a second."""
        if self._record is None:
            return
        self._log(layout.CLOCK, self._clock(), self._now())
        lost, self.overflown = self.overflown, 0
        if lost:
            self._gap("", self._now() - int(_EACH * 1e9), "too_slow", "the recorder was too slow", lost)
        self._record.tick()

    def _write(self, board: Board) -> None:
        """What has come. Raises CmError when the manager is gone."""
        while self._came:
            came = self._came.popleft()
            if isinstance(came, CmError):
                raise came
            self._publication(board, *came)

    def _publication(self, board: Board, at: int, frames: list[bytes]) -> None:
        event = decode_event(frames)
        time_ns = at + self._shift
        if isinstance(event, Irq):
            time_ns = self._opened.time_of(event.timestamp_ns)
        elif isinstance(event, Audit):
            time_ns = self._opened.time_of(event.ended_ns or event.began_ns)
        elif isinstance(event, RegValues):
            self._values.update((value.name, value) for value in event.values)
        elif isinstance(event, Status):
            self._know(board, event)
            self._tell_lost(event)
        self._log(frames[0].decode(), frames[1], time_ns)
        if isinstance(event, Status):
            self._changed(board, event)

    def _tell_lost(self, status: Status) -> None:
        """The manager numbers its statuses; ZeroMQ drops them where a reader does not keep up."""
        known = self._status
        if known is not None and known.started_ns == status.started_ns and status.sequence > known.sequence + 1:
            lost = status.sequence - known.sequence - 1
            self._gap(layout.STATUS, self._now(), "too_slow", "publications were lost on their way", lost)

    def _changed(self, board: Board, status: Status) -> None:
        """Another configuration or mode: what it has is looked up, and its streams are watched."""
        known, self._status = self._status, status
        if status.fpga_busy or known is None:
            return
        if status.last_change != known.last_change:  # how long its steps took, and who asked for it
            self._past = board.ask(calls.history())
            self._log(layout.STATUS, self._with_past(status), self._now())
        if _place(status) == _place(known) and status.config_name == self._config.name:
            return
        self._look_up(board, status)
        now = self._now()
        self._log(layout.CONFIG, encoded(self._config), now)
        values = RegValues(tuple(self._values.values()), status.config_name, status.mode)
        self._log(layout.REGISTERS, encoded(values), now)

    # ---- frames --------------------------------------------------------------------------

    def _watch(self, board: Board, status: Status) -> None:
        """Read the streams that are wanted and there."""
        there = {stream.name for stream in status.streams if self._wanted.has(stream)}
        for name in self._streams.keys() - there:
            self._streams.pop(name).stop()
        for name in there - self._streams.keys():
            self._streams[name] = _StreamThread(board, name, self._frame)

    def _frame(self, frame: Frame) -> None:
        """In the thread of its stream."""
        record, info = self._record, frame.info
        if record is None:
            return
        time_ns = self._opened.time_of(info.timestamp_ns)
        topic = layout.STREAM_PREFIX + info.stream
        slow = info.lost - info.failed
        if slow > 0:
            self._gap(topic, time_ns, "too_slow", f"{slow} frames came while the recorder was too slow", slow)
        wanted = self._wanted
        kept = bool(wanted.every) and info.sequence % wanted.every == 0
        data = np.ascontiguousarray(frame).reshape(-1).view(np.uint8) if kept or wanted.hashed else None
        digest = sha256(data.data).digest() if wanted.hashed and data is not None else b""
        seen = encode_frame_seen(info, kept, digest)
        record.log(record.channel(layout.FRAME_PREFIX + info.stream, layout.FRAME), seen, time_ns)
        if kept and data is not None:
            head = pictures.head_of(info, data.nbytes, time_ns)
            channel = record.channels.of(topic, pictures.SCHEMA) if head.picture else record.channel(topic, layout.DATA)
            record.log(channel, (head.data, data.data), time_ns)


class _StreamThread:
    """Reads one stream until it is stopped; one that is refused or stopped is tried again."""

    def __init__(self, board: Board, name: str, take: Callable[[Frame], None]) -> None:
        self._board, self._name, self._take = board, name, take
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"stream {name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                with self._board.stream(self._name, timeout=_EACH / 2, depth=_DEPTH, raw=True) as stream:
                    while not self._stopped.is_set():
                        try:
                            frame = stream.read()
                        except Timeout:
                            continue
                        self._take(frame)
                        frame.release()
            except CmError:
                self._stopped.wait(_EACH)

    def stop(self) -> None:
        """End soon."""
        self._stopped.set()

    def join(self) -> None:
        """Wait for the end."""
        self._thread.join()


def _place(status: Status) -> object:
    """What a description is valid for: if this differs, ask for another."""
    streams = tuple((s.name, s.direction, s.shape, s.dtype) for s in status.streams)
    return status.config_name, status.mode, streams, tuple((region.name, region.module) for region in status.regions)
