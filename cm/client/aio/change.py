# SPDX-License-Identifier: Apache-2.0
"""A change of the asyncio client, to be waited for later."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cm.client.aio.request_reply import Subscription
from cm.client.core import calls
from cm.client.core.change import ChangeWatch
from cm.wire.messages.status import Progress

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller


class ChangeHandle:
    """A change under way. Dropping the handle does not stop the change."""

    def __init__(self, board: Caller, number: int, subscription: Subscription) -> None:
        self._board = board
        self._subscription = subscription
        self._watch = ChangeWatch(number, subscription)

    @property
    def number(self) -> int:
        """The change's number, as in `status.last_change`."""
        return self._watch.number

    @property
    def progress(self) -> Progress | None:
        """Progress in the newest status that was read; None before the first."""
        return self._watch.progress

    async def done(self) -> bool:
        """Whether it has ended, well or not."""
        return await self._board.run(self._watch.arrived())

    async def wait(self, timeout: float | None = None) -> float:
        """Wait for its end; returns the seconds that it took. Raises RequestFailed, Timeout after `timeout` seconds."""
        return await self._board.run(self._watch.waiting(timeout))

    async def cancel(self) -> None:
        """Cancel it before its next load; the board goes back."""
        await self._board.ask(calls.cancel())

    def __del__(self) -> None:
        self._subscription.close()

    def __repr__(self) -> str:
        return f"<change {self.number}{', ended' if self._watch.has_ended else ''}>"
