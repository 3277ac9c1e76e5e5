# SPDX-License-Identifier: Apache-2.0
"""A record on the page instead of a manager: the same topics, as they were at a moment that the page chooses."""

from __future__ import annotations

import asyncio
import os
from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cm.errors import CmError, InvalidRequest
from cm.recording.layout import STREAM_PREFIX
from cm.recording.reader import Record
from cm.recording.story import Story, stories
from cm.web import pictures
from cm.web.commands import Commands, NotAllowed
from cm.web.hub import Hub
from cm.web.shown_streams import Watched, Watching
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import FrameInfo, PastChange, StepTaken

_STEP = 50_000_000  # nanoseconds between two moments that are told apart


class RecordHub(Hub):
    """Tells pages a record. `seek` goes to a moment; the page begins with the last."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidRequest."""
        self._record = Record(path)
        self._moments: list[tuple[int, Story]] = []
        self._shown: Story | None = None
        self.moved = asyncio.Event()
        super().__init__(_nobody, control=False)

    async def run(self) -> None:
        """Until it is cancelled."""
        self._tell_link("the record is being read")
        try:
            self._moments = await asyncio.to_thread(self._read)
            await self.seek(1 << 63)
        except CmError as error:
            self._tell_link(str(error))
        await asyncio.Event().wait()

    def _read(self) -> list[tuple[int, Story]]:
        found: list[tuple[int, Story]] = []
        for story in stories(self._record.opened, self._record.events(lambda t: not t.startswith(STREAM_PREFIX))):
            if not story.status.started_ns:
                continue
            if found and story.at_ns - found[-1][0] < _STEP and story.status is found[-1][1].status:
                found.pop()
            found.append((story.at_ns, story))
        if not found:
            raise InvalidRequest(f"{self._record.files[0]}: no state is in it")
        return found

    async def seek(self, time_ns: int) -> None:
        """Show the record as it was at one of its times."""
        if not self._moments:
            raise InvalidRequest("the record is being read")
        number = max(0, bisect_right(self._moments, time_ns, key=lambda moment: moment[0]) - 1)
        _, story = self._moments[number]
        self._tell_record(story)
        if story is self._shown:
            return
        before, self._shown = self._shown, story
        self.status = story.status
        config = story.config
        self.topics.tell("config", {**plain(config), "schema": ""} if config.name else None)
        modes = [plain(mode) for mode in config.modes]
        self.topics.tell("configs", {config.name: {"type": config.type, "modes": modes}} if config.name else {})
        counts = {irq.name: irq for irq in story.interrupts.values()}
        known: dict[str, dict[str, Any]] = {
            i.name: {"count": i.count, "at": None, "doc": i.doc} for i in config.interrupts
        }
        for name, irq in counts.items():
            known[name] = {**known.get(name, {}), "count": irq.count, "at": (irq.timestamp_ns + story.offset_ns) / 1e9}
        self.topics.tell("interrupts", known)
        fields = {name: {"value": value, "fields": _fields(story, name, value)} for name, value in story.values.items()}
        self.topics.tell("registers", fields)
        self.topics.tell("changes", [_change(story, change) for change in story.changes[-20:]])
        gaps = [{"at": gap.until_ns / 1e9, "code": gap.cause, "message": gap.text} for gap in story.gaps[-50:]]
        error = story.status.last_error
        last = [{"at": story.at_ns / 1e9, "code": error.code, "message": error.message}] if error else []
        self.topics.tell("errors", [*gaps, *last])
        self.topics.tell("status", plain(story.status))
        if before is None or before.frames != story.frames:
            self.moved.set()

    def _tell_record(self, story: Story) -> None:
        since, until = self._moments[0][0], self._moments[-1][0]
        record = {"since_ms": since // 10**6, "until_ms": until // 10**6, "at_ms": story.at_ns // 10**6}
        name = self._record.files[0].name
        link = {"up": True, "problem": "", "control": False, "pid": os.getpid()}
        self.topics.tell("link", {**link, "record": {**record, "name": name, "problems": self._record.problems}})

    def frame(self, stream: str) -> tuple[FrameInfo, bytes] | None:
        """The last frame of a stream by now whose data are in the record. Any thread."""
        story = self._shown
        return self._record.frame(stream, story.at_ns) if story is not None else None


def _nobody() -> Any:
    raise AssertionError("a record has no manager")


def _fields(story: Story, name: str, value: int) -> dict[str, int]:
    register = next((register for register in story.config.registers if register.name == name), None)
    fields = register.fields if register is not None else ()
    return {field.name: value >> field.lsb & ((1 << field.width) - 1) for field in fields}


def _change(story: Story, change: PastChange) -> dict[str, Any]:
    """As `cm.web.changes` has it."""
    state = "running" if not change.ended_ns else "failed" if change.error else "done"
    told: dict[str, Any] = {
        "number": change.number, "config": change.config_name, "mode": change.mode,
        "at": (change.begun_ns + story.offset_ns) / 1e9, "state": state, "steps": [_step(s) for s in change.steps],
        "seconds": (change.ended_ns - change.begun_ns) / 1e9 if change.ended_ns else None,
    }  # fmt: skip
    if change.error is not None:
        told["error"] = {"code": change.error.code, "message": change.error.message}
    return told


def _step(step: StepTaken) -> dict[str, Any]:
    return {"step": step.kind, "subject": step.subject, "seconds": step.seconds or None}


class RecordedFrames(Watching):
    """The frames that a record has, one for each moment that the page goes to."""

    def __init__(self, hub: RecordHub) -> None:
        super().__init__(hub)
        self._record = hub

    async def _read(self, stream: str, watched: Watched) -> None:
        shown = None
        while True:
            found = await asyncio.to_thread(self._record.frame, stream)
            watched.problem = "" if found else "the record has no data of its frames by then"
            self._tell()
            wanted = watched.wanted
            if found is not None and (found[0].sequence, wanted) != shown:
                shown = found[0].sequence, wanted
                await self._show_recorded(stream, watched, *found)
            await asyncio.sleep(0.1)
            self._record.moved.clear()
            try:
                await asyncio.wait_for(self._record.moved.wait(), 1.0)
            except asyncio.TimeoutError:  # another page may want it drawn otherwise
                continue

    async def _show_recorded(self, stream: str, watched: Watched, info: FrameInfo, data: bytes) -> None:
        about = {"sequence": info.sequence, "mode": info.mode}
        try:
            frame = np.frombuffer(data, np.dtype(info.dtype)).reshape(info.shape or (-1,))
        except (TypeError, ValueError) as error:
            watched.problem = f"a frame of {len(data)} bytes is not {info.shape} of {info.dtype}: {error}"
            self._tell()
            return
        watched.pictures = {
            wanted: await asyncio.to_thread(pictures.message, stream, frame, about, wanted.view, wanted.near)
            for wanted in watched.wanted
        }
        watched.number += 1
        for _, on_picture in tuple(watched.watchers.values()):
            on_picture(stream)


class RecordCommands(Commands):
    """What a page may ask of a record: a moment."""

    def __init__(self, hub: RecordHub) -> None:
        super().__init__(hub, control=False)
        self._record = hub

    async def do(self, what: str, words: Mapping[str, Any]) -> Any:
        """Go to a moment. Raises CmError."""
        if what != "at":
            raise NotAllowed("this is a record: nothing of it can be read again, or changed")
        at = words.get("ms")
        if not isinstance(at, int) or isinstance(at, bool):
            raise InvalidRequest(f"ms: milliseconds since the epoch are wanted, not {at!r}")
        await self._record.seek(min(max(at, 0), 1 << 50) * 10**6 + 10**6 - 1)
