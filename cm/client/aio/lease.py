# SPDX-License-Identifier: Apache-2.0
"""A lease as a context manager; setup.py makes the blocking `cm.client.lease` of it, without `await`."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from cm.client.core import calls, leases
from cm.client.core.leases import HeldLeases
from cm.errors import CmError
from cm.wire.messages.requests import TakeLease

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller


class BoardLease:
    """Held from entering to leaving, or until its time is over; `renew()` restarts its time.

    Leaving raises RequestNotFound where it had ended before; what ends the block with an error passes as it is.

    Meanwhile this board's own calls pass; `id` goes into the ``lease=`` of others. It also ends when this
    process dies (on the manager's machine).
    """

    def __init__(self, board: Caller, held: HeldLeases, request: TakeLease) -> None:
        self._board = board
        self._held = held
        self._wanted = request
        self.id: str = ""

    @property
    def scope(self) -> str:
        """What it holds."""
        return self._wanted.scope

    async def take(self) -> str:
        """Take it; returns its id. Raises RequestBusy with the holder's name."""
        self.id = (await self._board.ask(calls.lease(self._wanted))).id
        self._held.add(self.id)
        return self.id

    async def renew(self) -> None:
        """Restart its time. Raises RequestNotFound if it has ended."""
        await self._board.ask(calls.lease(leases.renewal(self._wanted, self.id)))

    async def release(self) -> None:
        """Give it back; twice is fine."""
        if self.id:
            held, self.id = self.id, ""
            self._held.remove(held)
            await self._board.ask(calls.lease(leases.release(held)))

    async def __aenter__(self) -> BoardLease:
        await self.take()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        try:
            await self.release()
        except CmError:
            if error is None:  # else what ended the block is told, Ctrl-C too
                raise

    def __repr__(self) -> str:
        return f"<lease on {self.scope}{f', {self.id}' if self.id else ', not held'}>"
