# SPDX-License-Identifier: Apache-2.0
"""The one connection to the manager that all pages share, and what it has sent, for the pages."""

from __future__ import annotations

import asyncio
import os
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from cm.client.aio.board import Board
from cm.errors import CmError
from cm.web.changes import ChangeLog
from cm.web.history import History
from cm.web.topics import Topics
from cm.wire import topics as wire
from cm.wire.encode import decode_event
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import ConfigInfo, Irq, RegValues, Status

_INTERVAL = 1.0  # seconds between two looks at the status, and between two tries to connect
_ERRORS = 50
Connect = Callable[[], Board]


class Hub:
    """Follows the manager from `run` on; if it goes away, waits until it is back."""

    def __init__(self, connect: Connect, control: bool) -> None:
        self._connect = connect
        self._control = control
        self.topics = Topics()
        self.board: Board | None = None
        self.status: Status | None = None
        self.connected = asyncio.Event()
        self.history = History()
        self._changes = ChangeLog()
        self._config: ConfigInfo | None = None
        self._registers: dict[str, Any] = {}
        self._interrupts: dict[str, dict[str, Any]] = {}
        self._errors: deque[dict[str, Any]] = deque(maxlen=_ERRORS)
        self._last_error: tuple[str, str] | None = None
        self._started_ns = 0
        self._stale = asyncio.Event()  # the mode has changed: its description has to be asked for again
        self._tell_link("not connected yet")
        for topic, nothing in (("errors", []), ("changes", []), ("interrupts", {})):
            self.topics.tell(topic, nothing)

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            try:
                async with self._connect() as board:
                    await self._follow(board)
            except (CmError, OSError) as error:
                self._tell_link(str(error))
            finally:
                self.board = None
                self.connected.clear()
            await asyncio.sleep(_INTERVAL)

    async def _follow(self, board: Board) -> None:
        self.board = board
        self._stale.set()
        await self._look(board)
        self._tell_link("")
        self.connected.set()
        tasks = [
            asyncio.create_task(work(board)) for work in (self._listen, self._look_again, self._describe, Board._gone)
        ]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def _tell_link(self, problem: str) -> None:
        self.topics.tell("link", {"up": not problem, "problem": problem, "control": self._control, "pid": os.getpid()})

    # ---- what is told unasked -------------------------------------------------------------

    async def _listen(self, board: Board) -> None:
        subscription = board.subscribe(wire.STATUS, wire.READ_REG, wire.IRQ)
        try:
            while True:
                frames = await subscription.receive(None)
                if frames is not None:
                    self.take(decode_event(frames))
        finally:
            with suppress(CmError):
                subscription.close()

    def take(self, event: Any) -> None:
        """What the manager has told."""
        if isinstance(event, Status):
            self._status(event)
        elif isinstance(event, RegValues):
            self.take_registers(event)
        elif isinstance(event, Irq):
            self._interrupt(event)

    def _status(self, status: Status) -> None:
        before = self.status
        if before is not None and before.started_ns == status.started_ns and before.sequence > status.sequence:
            return  # a reply that a later status has overtaken
        self.status = status
        if status.started_ns != self._started_ns:
            self._started_ns = status.started_ns
            self._changes.forget()
            self._interrupts.clear()
        if self._changes.take(status):
            self.topics.tell("changes", list(self._changes.changes))
        if before is None or _place(before) != _place(status):
            self._stale.set()
        self._note(status)
        self.topics.tell("status", plain(status))

    def _note(self, status: Status) -> None:
        """Note each error once, when it is first reported."""
        error = status.last_error
        known = (error.code, error.message) if error else None
        if known != self._last_error and error is not None:
            self._errors.append({"at": time.time(), "code": error.code, "message": error.message})
            self.topics.tell("errors", list(self._errors))
        self._last_error = known

    def take_registers(self, values: RegValues) -> None:
        """What registers hold now."""
        for value in values.values:
            self._registers[value.name] = {"value": value.value, "fields": dict(value.fields)}
        self.topics.tell("registers", self._registers)

    def _interrupt(self, irq: Irq) -> None:
        offset = self.status.realtime_offset_ns if self.status else 0
        self._interrupts[irq.name] = {"count": irq.count, "at": (irq.timestamp_ns + offset) / 1e9}
        self.topics.tell("interrupts", self._interrupts)

    # ---- what is asked for ------------------------------------------------------------------

    async def _look(self, board: Board) -> None:
        status = await board.status()
        self._status(status)
        self.topics.tell("point", self.history.add(time.time(), status))

    async def _look_again(self, board: Board) -> None:
        """Rates, latencies and sensors are not published when nothing else happens."""
        while True:
            await asyncio.sleep(_INTERVAL)
            await self._look(board)

    async def _describe(self, board: Board) -> None:
        while True:
            await self._stale.wait()
            self._stale.clear()
            try:
                await self._ask_all(board)
            except (CmError, ConnectionError) as error:
                if isinstance(error, ConnectionError):
                    raise
                self.topics.tell("config", None)  # nothing is loaded, or another change has begun
                await asyncio.sleep(_INTERVAL)

    async def _ask_all(self, board: Board) -> None:
        status = self.status
        others = {}
        for name in status.configs if status else ():
            info = await board.config(name)
            others[name] = {"type": info.type, "modes": [plain(mode) for mode in info.modes]}
        self.topics.tell("configs", others)
        if status is None or not status.config_name:
            self.topics.tell("config", None)
            return
        self._config = await board.config()
        self._interrupts = {
            i.name: {"count": i.count, "at": self._interrupts.get(i.name, {}).get("at"), "doc": i.doc}
            for i in self._config.interrupts
        }
        self.topics.tell("interrupts", self._interrupts)
        self.topics.tell("config", {**plain(self._config), "schema": ""})
        self._registers = {}
        self.topics.tell("registers", self._registers)
        if not status.fpga_busy:
            await self.read_registers(board, ())

    async def read_registers(self, board: Board, names: tuple[str, ...]) -> None:
        """Ask for registers, all that can be read if none is named. Raises CmError."""
        from cm.client.core import calls

        self.take_registers(await board.ask(calls.read_registers(names)))


def _place(status: Status) -> tuple[Any, ...]:
    """The part of a status whose change makes earlier answers void."""
    return status.config_name, status.mode, status.configs, status.fpga_busy, status.started_ns
