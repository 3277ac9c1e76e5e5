# SPDX-License-Identifier: Apache-2.0
"""Interrupts of the blocking client: ``board.interrupts["frame_done"].wait(timeout=1.0)``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from cm.client.core import calls
from cm.client.core.events import InterruptEvents
from cm.client.events import EventStream
from cm.wire.messages.status import Irq

if TYPE_CHECKING:
    from cm.client.request_reply import Caller


class Interrupts:
    """Interrupts of the loaded configuration by name."""

    def __init__(self, board: Caller) -> None:
        self._board = board
        self._seen: dict[str, int] = {}  # by name: the time of the one that ended the last wait, ns

    def __getitem__(self, name: str) -> Interrupt:
        """The interrupt of that name; whether it exists is checked when it is used."""
        return Interrupt(self._board, name, self._seen)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __len__(self) -> int:
        return len(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """The interrupts of the loaded configuration."""
        return tuple([i.name for i in self._board.ask(calls.describe()).interrupts])

    def __repr__(self) -> str:
        return f"<interrupts of {self._board!r}>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.names)


class Interrupt:
    """One interrupt."""

    def __init__(self, board: Caller, name: str, seen: dict[str, int]) -> None:
        self._board = board
        self.name = name
        self._seen = seen

    @property
    def count(self) -> int:
        """How many times it has occurred since the configuration was loaded."""
        return self._board.ask(calls.interrupt(self.name)).count

    def wait(self, timeout: float | None = None) -> Irq:
        """Wait for one since this client's last wait, or since the configuration was loaded; it may have come already.

        `events()` counts from its opening instead. `timeout` in seconds, None waits for ever. Raises Timeout.
        """
        subscription = self._board.subscribe(*InterruptEvents.topics)
        since = self._seen.get(self.name, 0)
        with EventStream(self._board, subscription, InterruptEvents(subscription, timeout, self.name, since)) as events:
            came = events.next()
        self._seen[self.name] = came.timestamp_ns
        return came

    def events(self, timeout: float | None = None) -> EventStream[Irq]:
        """All interrupts of this name from now on. Raises Timeout if none comes for `timeout` seconds."""
        subscription = self._board.subscribe(*InterruptEvents.topics)
        return EventStream(self._board, subscription, InterruptEvents(subscription, timeout, self.name))

    def __repr__(self) -> str:
        return f"<interrupt {self.name}>"
