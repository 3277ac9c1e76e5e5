# SPDX-License-Identifier: Apache-2.0
"""What a board of a fleet does with its manager, which is asked in a caller's name."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from cm.client.aio.relay import Relay
from cm.client.core import calls
from cm.client.errors import ConnectionLost, NoAnswer, RequestFailed
from cm.errors import CmError
from cm.networks.fleet.reconciling_board import NotUndone, Part, Place, Planned, Seen, Unsettled
from cm.wire.messages import requests as rq
from cm.wire.messages.fleet import FleetStep

HOLD = 15.0  # seconds for which others are kept off; renewed while a change is open and the store answers


def seen(place: Place, manager: int, ended_ns: int) -> Seen:
    """Of a status: its last change's end is by the clock of its machine, that we share, or nearly so."""
    return Seen(place, manager, time.monotonic() - (time.time_ns() - ended_ns) / 1e9)


class ManagedBoard:
    """The manager, asked in the caller's name."""

    def __init__(self, relay: Relay, told: Callable[[], Seen | None]) -> None:
        """`told`: where it is, as it said by itself; None if that is not known."""
        self.relay, self._told = relay, told
        self._held = 0.0  # when the lease was taken or renewed last, monotonic

    def guest(self, caller: str) -> str:
        return f"zenoh:{caller}"

    async def where(self, known: Seen | None = None) -> Seen:
        if known is not None and self._told() == known:
            return known
        try:
            status = await self.relay.ask(calls.status())
        except (ConnectionLost, NoAnswer) as error:
            raise Unsettled(str(error)) from error
        if status.fpga_busy:
            raise Unsettled("a change is under way on this board")
        ended = status.last_change_ns + status.realtime_offset_ns
        return seen((status.config_name, status.mode), status.started_ns, ended)

    async def plan(self, step: FleetStep, caller: str) -> Planned:
        """All files are read and checked for that."""
        plan = await self.relay.ask(calls.plan(step.mode, step.config_name), self.guest(caller), timeout=60.0)
        return Planned((plan.config_name, plan.mode), plan.seconds, plan.bytes)

    async def hold(self, part: Part) -> str:
        if part.lease and (time.monotonic() - self._held < HOLD / 3 or await self._renewed(part)):
            return part.lease
        holder = f"fleet change {part.change} of {part.caller}"
        taking = calls.lease(rq.TakeLease("board", True, seconds=HOLD, holder=holder, pid=0))
        lease = await self.relay.ask(taking, self.guest(part.caller))
        self._held = time.monotonic()
        return lease.id

    async def _renewed(self, part: Part) -> bool:
        try:
            await self.relay.ask(calls.lease(rq.RenewLease(part.lease, HOLD, pid=0)), self.guest(part.caller))
        except RequestFailed:  # the manager was restarted meanwhile, or the lease ran out
            return False
        self._held = time.monotonic()
        return True

    async def release(self, part: Part) -> None:
        """If it cannot be given back, it runs out."""
        if part.lease:
            with contextlib.suppress(CmError):
                await self.relay.ask(calls.lease(rq.ReleaseLease(part.lease)), self.guest(part.caller))

    async def load(self, place: Place, caller: str, lease: str = "", undoable: str = "", undo: str = "") -> float:
        call = calls.load(*place, wait=True, queue=True, force=False, lease=lease, undoable=undoable, undo=undo)
        try:
            return (await self.relay.ask(call, self.guest(caller), timeout=None)).seconds
        except (ConnectionLost, NoAnswer) as error:
            raise Unsettled(str(error)) from error

    async def undo(self, part: Part) -> None:
        try:
            await self.load(part.old, part.caller, part.lease, undo=part.change)
        except RequestFailed as error:
            raise NotUndone(str(error)) if error.code == NotUndone.code else error from None
