# SPDX-License-Identifier: Apache-2.0
"""Interrupts of the asyncio client: ``await board.interrupts["frame_done"].wait(timeout=1.0)``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cm.client.aio.events import EventStream
from cm.client.core import calls
from cm.client.core.events import InterruptEvents
from cm.wire.messages.status import Irq

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller


class Interrupts:
    """Interrupts of the loaded configuration by name."""

    def __init__(self, board: Caller) -> None:
        self._board = board
        self._seen: dict[str, int] = {}  # by name: the time of the one that ended the last wait, ns

    def __getitem__(self, name: str) -> Interrupt:
        """The interrupt of that name; whether it exists is checked when it is used."""
        return Interrupt(self._board, name, self._seen)

    async def names(self) -> tuple[str, ...]:
        """The interrupts of the loaded configuration."""
        return tuple([i.name for i in (await self._board.ask(calls.describe())).interrupts])

    def __repr__(self) -> str:
        return f"<interrupts of {self._board!r}>"


class Interrupt:
    """One interrupt."""

    def __init__(self, board: Caller, name: str, seen: dict[str, int]) -> None:
        self._board = board
        self.name = name
        self._seen = seen

    async def count(self) -> int:
        """How many times it has occurred since the configuration was loaded."""
        return (await self._board.ask(calls.interrupt(self.name))).count

    async def wait(self, timeout: float | None = None) -> Irq:
        """Wait for one since this client's last wait, or since the configuration was loaded; it may have come already.

        `events()` counts from its opening instead. `timeout` in seconds, None waits for ever. Raises Timeout.
        """
        subscription = self._board.subscribe(*InterruptEvents.topics)
        since = self._seen.get(self.name, 0)
        events = EventStream(self._board, subscription, InterruptEvents(subscription, timeout, self.name, since))
        async with events:
            came = await events.next()
        self._seen[self.name] = came.timestamp_ns
        return came

    def events(self, timeout: float | None = None) -> EventStream[Irq]:
        """Each one from its opening on. Raises Timeout if none comes for `timeout` seconds."""
        subscription = self._board.subscribe(*InterruptEvents.topics)
        return EventStream(self._board, subscription, InterruptEvents(subscription, timeout, self.name))

    def __repr__(self) -> str:
        return f"<interrupt {self.name}>"
