# SPDX-License-Identifier: Apache-2.0
"""What is known of a board at a moment, and how it came there: from a manager that runs, or from a record."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from cm.frozen import dataclass, field, replace
from cm.recording.layout import AUDIT, CONFIG, FRAME_PREFIX, GAP, IRQ, REGISTERS, STATUS, Opened
from cm.recording.reader import Event
from cm.wire.messages.status import (
    NOTICES,
    Audit,
    ConfigInfo,
    ErrorInfo,
    Irq,
    PastChange,
    PastWrite,
    Progress,
    RegValues,
    Status,
    StepTaken,
)
from cm.wire.records import Gap

_AUDITS = 1024  # that are kept


@dataclass(frozen=True, slots=True)
class Story:
    """A moment. Times of what the manager tells are CLOCK_MONOTONIC; `offset_ns` more is wall time.

    `since_ns`: from when on it is known what happened, and `at_ns` the moment, both wall time. `recorded`: it is
    another's past. `frames`: of each stream, how many came, and how many are missing between them.
    """

    status: Status
    offset_ns: int
    since_ns: int
    at_ns: int
    recorded: bool = False
    config: ConfigInfo = ConfigInfo()
    changes: tuple[PastChange, ...] = ()
    writes: tuple[PastWrite, ...] = ()
    values: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    interrupts: Mapping[str, Irq] = field(default_factory=lambda: MappingProxyType({}))
    frames: Mapping[str, tuple[int, int]] = field(default_factory=lambda: MappingProxyType({}))
    gaps: tuple[Gap, ...] = ()


def of_manager(status: Status, config: ConfigInfo, now_ns: int) -> Story:
    """The present, of a status with its history; `now_ns`: CLOCK_REALTIME."""
    changes, writes = status.changes, status.writes
    offset = status.realtime_offset_ns
    return Story(status, offset, status.started_ns, now_ns, config=config, changes=changes, writes=writes)


def of_record(opened: Opened, events: Iterable[Event]) -> Story:
    """What a record has told by its last event."""
    story = None
    for story in stories(opened, events):  # noqa: B007 (the last)
        pass
    return story if story is not None else Story(Status(), opened.offset_ns, opened.started_ns, opened.started_ns, True)


def stories(opened: Opened, events: Iterable[Event]) -> Iterator[Story]:
    """What is known behind each event; the same object where it tells nothing that a story holds."""
    teller = _Teller(opened)
    for event in events:
        teller.take(event)
        yield teller.story


class _Teller:
    """Puts a record's events together: the manager numbers changes and writes, and the audit says whose they are."""

    def __init__(self, opened: Opened) -> None:
        start = opened.started_ns
        self.story = Story(Status(), opened.offset_ns, start, start, recorded=True)
        self._changes: dict[int, PastChange] = {}
        self._exact: set[int] = set()  # numbers of changes that the manager has described at their end
        self._writes: dict[str, PastWrite] = {}
        self._by: dict[int, Audit] = {}  # who asked, by change
        self._wrote: dict[int, Audit] = {}  # who wrote, by generation
        self._generations: dict[str, int] = {}  # of the last write, by register
        self._sequences: dict[str, int] = {}  # of the last frame, by stream

    def take(self, event: Event) -> None:
        """Note what an event says."""
        topic, value = event.topic, event.value
        at = event.time_ns - self.story.offset_ns
        if topic == STATUS:
            self._status(value, at)
        elif topic == AUDIT:
            self._audit(value)
        elif topic == REGISTERS:
            self._registers(value, at)
        elif topic == CONFIG:
            self._tell(config=value)
        elif topic == IRQ:
            self._tell(interrupts=MappingProxyType({**self.story.interrupts, value.name: value}))
        elif topic == GAP:
            self._tell(gaps=(*self.story.gaps, value))
        elif topic.startswith(FRAME_PREFIX):
            self._frame(value.frame.stream, value.frame.sequence)
        else:
            return
        self._tell(at_ns=max(self.story.at_ns, event.time_ns))

    def _tell(self, **changed: Any) -> None:
        self.story = replace(self.story, **changed)

    def _frame(self, stream: str, sequence: int) -> None:
        count, missing = self.story.frames.get(stream, (0, 0))
        before, self._sequences[stream] = self._sequences.get(stream, sequence - 1), sequence
        missing += max(0, sequence - before - 1)
        self._tell(frames=MappingProxyType({**self.story.frames, stream: (count + 1, missing)}))

    def _status(self, status: Status, at: int) -> None:
        before = self.story.status
        if before.started_ns not in (0, status.started_ns):  # another manager: its numbers are others
            self._changes.clear()
            for known in (self._writes, self._by, self._wrote, self._generations):
                known.clear()
            self._exact.clear()
        for change in status.changes:
            if change.ended_ns:
                self._changes[change.number] = change
                self._exact.add(change.number)
            elif change.number not in self._changes:  # its steps: those of before the record, the others are told
                self._changes[change.number] = change if before.sequence == 0 else replace(change, steps=())
        for write in status.writes:
            self._writes[write.name] = write
        if status.progress is not None:
            self._goes_on(status.progress, before, at)
        else:
            self._ended(status, before, at)
        if status.config_name != before.config_name and before.config_name:
            self._writes.clear()
        told = replace(status, changes=(), writes=())
        self._tell(status=told, changes=tuple(self._changes.values()), writes=tuple(self._writes.values()))

    def _goes_on(self, progress: Progress, before: Status, at: int) -> None:
        number = progress.change
        change = self._changes.get(number)
        if number in self._exact:
            return
        if change is None:
            place = progress.target_config, progress.target_mode, before.config_name, before.mode
            change = PastChange(number, *place, begun_ns=at, by=self._asked(number))
        steps = change.steps
        if not steps or (steps[-1].kind, steps[-1].subject) != (progress.step, progress.subject):
            steps = (*steps, StepTaken(progress.step, progress.subject, at))
        self._changes[number] = replace(change, steps=steps)

    def _ended(self, status: Status, before: Status, at: int) -> None:
        number = status.last_change
        change = self._changes.get(number)
        if number in self._exact or number == 0 or (change is None and number == before.last_change):
            return
        if change is None and before.sequence == 0:
            return  # it ended before the record began
        if change is not None and change.ended_ns:
            return
        if change is None:
            change = PastChange(number, status.config_name, status.mode, before.config_name, before.mode)
        error = _failed(change, status)
        begun = change.begun_ns or (status.last_change_ns or at) - round(status.last_change_seconds * 1e9)
        self._changes[number] = replace(
            change, begun_ns=begun, ended_ns=status.last_change_ns or at, error=error,
            by=change.by or self._asked(number),
        )  # fmt: skip

    def _asked(self, number: int) -> str:
        audit = self._by.get(number)
        return audit.client if audit is not None else ""

    def _audit(self, audit: Audit) -> None:
        if audit.change:
            self._by[audit.change] = audit
            change = self._changes.get(audit.change)
            if change is not None and not change.by:
                error = change.error or audit.error
                self._changes[audit.change] = replace(change, by=audit.client, error=error)
                self._tell(changes=tuple(self._changes.values()))
        if audit.generation and audit.request == "WriteReg":
            self._wrote[audit.generation] = audit
            if len(self._wrote) > _AUDITS:
                del self._wrote[next(iter(self._wrote))]
            for name in [n for n, generation in self._generations.items() if generation == audit.generation]:
                if name in self._writes:
                    self._writes[name] = replace(self._writes[name], by=audit.client, at_ns=audit.ended_ns)
            self._tell(writes=tuple(self._writes.values()))

    def _registers(self, values: RegValues, at: int) -> None:
        known = {**self.story.values, **{value.name: value.value for value in values.values}}
        if values.generation:
            audit = self._wrote.get(values.generation)
            for value in values.values:
                when = audit.ended_ns if audit is not None else at
                self._writes[value.name] = PastWrite(value.name, value.value, audit.client if audit else "", when)
                self._generations[value.name] = values.generation
        self._tell(values=MappingProxyType(known), writes=tuple(self._writes.values()))


def _failed(change: PastChange, status: Status) -> ErrorInfo | None:
    error = status.last_error
    if error is None or error.code in NOTICES:
        return None
    return error if status.pr_mode.value == "error" or change.mode != status.mode else None
