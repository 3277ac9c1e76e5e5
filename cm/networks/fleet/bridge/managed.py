# SPDX-License-Identifier: Apache-2.0
"""The manager, as a change of a fleet needs it: asked in the caller's name, with a lease that keeps others off."""

from __future__ import annotations

import contextlib
import time

from cm.client.aio.relay import Relay
from cm.client.core import calls
from cm.client.errors import ConnectionLost, NoAnswer, RequestFailed
from cm.errors import CmError
from cm.networks.fleet.bridge.records import Records
from cm.networks.fleet.change.ports import Planned, Unsettled
from cm.wire.messages import requests as rq
from cm.wire.messages.fleet import FleetRecord

HOLD = 60.0  # seconds of the lease; renewed while the change is open


class ManagedBoard:
    """`guest`: from a caller's name to the one that the manager knows; empty: in the bridge's own name."""

    def __init__(self, relay: Relay, records: Records, own_name: bool) -> None:
        self._relay = relay
        self._records = records
        self._own_name = own_name
        self._held = 0.0  # when the lease was taken or renewed last, CLOCK_MONOTONIC

    def guest(self, caller: str) -> str:
        """The name of a caller at the manager."""
        return "" if self._own_name else f"zenoh:{caller}"

    async def where(self) -> tuple[str, str]:
        """Configuration and mode. Raises Unsettled while a change runs, or the manager is away."""
        try:
            status = await self._relay.ask(calls.status())
        except (ConnectionLost, NoAnswer) as error:
            raise Unsettled(str(error)) from error
        if status.fpga_busy:
            raise Unsettled("a change is under way on this board")
        return status.config_name, status.mode

    async def plan(self, config: str, mode: str, caller: str) -> Planned:
        """What the change would involve; all files are read and checked for that."""
        plan = await self._relay.ask(calls.plan(mode, config), self.guest(caller), timeout=60.0)
        return Planned(plan.config_name, plan.mode, plan.seconds, plan.bytes)

    async def hold(self, record: FleetRecord) -> None:
        """Take the lease on the board, or renew it."""
        self._held = time.monotonic()
        held = self._records.lease(record.id)
        if held and await self._renewed(held, record.caller):
            return
        holder = f"fleet change {record.id} of {record.caller}"
        lease = await self._relay.ask(
            calls.lease(rq.TakeLease("board", True, HOLD, holder, 0)), self.guest(record.caller)
        )
        self._records.keep_lease(record.id, lease.id)

    async def keep_holding(self, record: FleetRecord) -> None:
        """Renew it in time while the change is open. Raises the manager's refusal."""
        if time.monotonic() - self._held > HOLD / 3:
            await self.hold(record)

    async def _renewed(self, lease: str, caller: str) -> bool:
        try:
            await self._relay.ask(calls.lease(rq.RenewLease(lease, HOLD, 0)), self.guest(caller))
        except RequestFailed:  # the manager was restarted meanwhile, or the lease ran out
            return False
        return True

    async def release(self, record: FleetRecord) -> None:
        """Give the lease back; if that is not possible, it runs out."""
        held = self._records.lease(record.id)
        if held:
            with contextlib.suppress(CmError):
                await self._relay.ask(calls.lease(rq.ReleaseLease(held)), self.guest(record.caller))
            self._records.keep_lease(record.id, "")

    async def load(self, config: str, mode: str, caller: str) -> float:
        """Go there. Raises Unsettled if the manager went away during it, and the manager's errors."""
        record = self._records.last()
        lease = self._records.lease(record.id) if record else ""
        call = calls.load(config, mode, wait=True, queue=True, force=False, lease=lease)
        try:
            return (await self._relay.ask(call, self.guest(caller), timeout=None)).seconds
        except (ConnectionLost, NoAnswer) as error:
            raise Unsettled(str(error)) from error
