# SPDX-License-Identifier: Apache-2.0
"""Events of the asyncio client."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Generic, TypeVar

from cm.client.aio.request_reply import Subscription
from cm.client.core.events import Events
from cm.client.core.flow_effects import DEFAULT, Limit
from cm.errors import Timeout

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller

T = TypeVar("T")


class EventStream(Generic[T]):
    """Every event from its opening on; an async iterator and context manager, each of which opens it."""

    def __init__(self, board: Caller, subscription: Subscription, events: Events[T]) -> None:
        self._board = board  # keeps the board alive
        self._subscription = subscription
        self._events = events
        self._is_open = False

    async def open(self) -> None:
        """Open it: from here on nothing is missed; twice is fine."""
        if self._is_open:
            return
        try:
            await self._board.run(self._events.opening())
        except BaseException:
            self._subscription.close()
            raise
        self._is_open = True

    async def next(self, timeout: Limit = DEFAULT) -> T:
        """The next one. `timeout` in seconds, None waits for ever. Raises Timeout, BoardClosed."""
        await self.open()
        return await self._board.run(self._events.next(timeout))

    async def poll(self) -> T | None:
        """The next one if it is there already; never waits once it is open."""
        try:
            return await self.next(0.0)
        except Timeout:
            return None

    def fileno(self) -> int:
        """A descriptor that becomes readable when something may have come: then call `poll` until it returns None."""
        return self._subscription.fileno()

    async def close(self) -> None:
        """Stop listening; twice is fine."""
        self._subscription.close()

    def __aiter__(self) -> EventStream[T]:
        return self

    async def __anext__(self) -> T:
        return await self.next()

    async def __aenter__(self) -> EventStream[T]:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.close()

    def __del__(self) -> None:
        self._subscription.close()
