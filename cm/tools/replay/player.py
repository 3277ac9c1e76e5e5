# SPDX-License-Identifier: Apache-2.0
"""What the hardware did in a record, done again by a simulated board in its rhythm, beneath an application."""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from cm.client.board import connect
from cm.errors import CmError
from cm.recording.layout import IRQ, REGISTERS, STREAM_PREFIX
from cm.recording.reader import Event
from cm.tools.replay.board import Bench, Faults
from cm.tools.replay.script import Script

_LOOK = 0.1  # seconds between two looks for the application
_SHARED = Path("/dev/shm")


class Player:
    """Plays one record on one board. `counts`: what was given back, and what nobody took, by kind."""

    def __init__(self, made: Bench, script: Script, wanted: Callable[[str], bool]) -> None:
        self._made, self._script, self._wanted = made, script, wanted
        self.counts: Counter[str] = Counter()
        self._channels = {stream.name: stream.channel for stream in made.board.status.streams}
        self._readable = {r.name for r in made.board.config().registers if r.access in ("ro", "w1c")}
        self._over = threading.Event()

    def wait_for_application(self) -> None:
        """Until somebody else asks the manager for something."""
        while len(self._made.board.clients()) < 2:
            if self._over.wait(_LOOK):
                return

    def play(self, since: int, until: int, speed: float = 1.0, on: bool = False) -> None:
        """All that lies between two times of the record, `speed` times as fast; 0: without pauses.

        `on`: the board goes on after that, with what faults are left, until `stop`.
        """
        with self._faults(), tempfile.TemporaryDirectory(dir=_SHARED if _SHARED.is_dir() else None) as folder:
            for name in self._script.streams & self._channels.keys():
                with contextlib.suppress(CmError):  # no camera is there
                    self._made.control.pause(self._channels[name])
            began, first = time.monotonic(), None
            for event in self._events(since, until):
                first = event.time_ns if first is None else first
                due = began + (event.time_ns - first) / 1e9 / speed if speed else 0.0
                if self._over.wait(max(0.0, due - time.monotonic())):
                    return
                self._give(event, Path(folder))
            if on:
                self._over.wait()

    def stop(self) -> None:
        """End playing, from another thread."""
        self._over.set()

    def _events(self, since: int, until: int) -> Iterator[Event]:
        def wanted(topic: str) -> bool:
            return self._wanted(topic) and (topic in (IRQ, REGISTERS) or topic.startswith(STREAM_PREFIX))

        for event in self._script.record.events(wanted):
            if event.time_ns > until:
                return
            if event.time_ns >= since:
                yield event

    def _give(self, event: Event, folder: Path) -> None:
        topic, control = event.topic, self._made.control
        try:
            if topic == IRQ:
                control.interrupt(event.value.name)
                self.counts["interrupts"] += 1
            elif topic == REGISTERS:
                for value in event.value.values:
                    if not event.value.generation and value.name in self._readable:
                        control.register(value.name, value.value)
                        self.counts["registers"] += 1
            elif topic.startswith(STREAM_PREFIX) and isinstance(event.value, bytes):
                self._frame(topic.removeprefix(STREAM_PREFIX), event.value, folder)
        except CmError as error:
            self.counts[f"not given back: {error}"] += 1

    def _frame(self, stream: str, data: bytes, folder: Path) -> None:
        channel = self._channels.get(stream)
        if channel is None:
            return
        file = folder / channel
        file.write_bytes(data)
        self._made.control.frame(channel, file)
        self.counts["frames"] += 1

    @contextlib.contextmanager
    def _faults(self) -> Iterator[None]:
        """The faults of the record; those that last are ended with their change, by a client of its own."""
        over = threading.Event()
        thread = threading.Thread(target=self._follow, args=(over,), name="replay-faults", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def _follow(self, over: threading.Event) -> None:
        faults = Faults(self._made, self._script, repairs=False)
        with contextlib.suppress(CmError), connect(runtime_dir=self._made.folder) as board:
            number = board.status.last_change
            with board.watch(timeout=None) as statuses:
                while not over.is_set():
                    with contextlib.suppress(TimeoutError):
                        status = statuses.next(_LOOK)
                        if not status.fpga_busy and status.last_change > number:
                            number = status.last_change
                            faults.next()
