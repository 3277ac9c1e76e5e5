# SPDX-License-Identifier: Apache-2.0
"""Events of the blocking client."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Generic, TypeVar

from cm.client.core.events import Events
from cm.client.core.flow_effects import DEFAULT, Limit
from cm.client.request_reply import Subscription
from cm.errors import Timeout

if TYPE_CHECKING:
    from cm.client.request_reply import Caller

T = TypeVar("T")


class EventStream(Generic[T]):
    """All events since it was made, as an iterator and a context manager. Iterating ends only by an exception."""

    def __init__(self, board: Caller, subscription: Subscription, events: Events[T]) -> None:
        self._board = board  # keeps the board alive
        self._subscription = subscription
        self._events = events
        try:
            board.run(events.opening())
        except BaseException:
            subscription.close()
            raise

    def next(self, timeout: Limit = DEFAULT) -> T:
        """The next one. `timeout` in seconds, None waits for ever. Raises Timeout, BoardClosed."""
        return self._board.run(self._events.next(timeout))

    def poll(self) -> T | None:
        """The next one if there is one already; never waits."""
        try:
            return self.next(0.0)
        except Timeout:
            return None

    def fileno(self) -> int:
        """A descriptor that becomes readable when something may have come: then call `poll` until it returns None."""
        return self._subscription.fileno()

    def close(self) -> None:
        """Stop listening; twice is fine."""
        self._subscription.close()

    def __iter__(self) -> EventStream[T]:
        return self

    def __next__(self) -> T:
        return self.next()

    def __enter__(self) -> EventStream[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()
