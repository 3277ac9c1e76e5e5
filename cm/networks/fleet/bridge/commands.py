# SPDX-License-Identifier: Apache-2.0
"""Commands under ``do/``: passed to the manager in the caller's name, or done here if they are the fleet's own."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from cm.client.aio.relay import Relay
from cm.errors import Busy, CmError, NotFound
from cm.networks.fleet import names
from cm.networks.fleet.bridge.managed import ManagedBoard
from cm.networks.fleet.change import member
from cm.networks.fleet.change.participant import Participant
from cm.networks.fleet.change.ports import Unsettled
from cm.networks.fleet.verbs import VERBS
from cm.wire import fleet as wire
from cm.wire.fleet_records import decode_step
from cm.wire.messages.fleet import BundleState, FetchBundle, FleetRecord, FleetStep
from cm.wire.messages.status import ErrorInfo

MANY = 64  # commands that may be under way at once

FetchAndImport = Callable[[FetchBundle, str], Awaitable[BundleState]]


class Commands:
    """Of one board."""

    def __init__(self, relay: Relay, participant: Participant, managed: ManagedBoard, bundles: FetchAndImport) -> None:
        self._relay = relay
        self._participant = participant
        self._managed = managed
        self._bundles = bundles
        self._one = asyncio.Lock()  # steps of changes, one after the other
        self._running = 0

    async def do(self, command: names.Command, message: bytes, payload: list[bytes]) -> bytes:
        """Carry it out; returns a serialised Reply, also for an error."""
        caller = command.caller or names.NOBODY
        try:
            if self._running >= MANY:
                raise Busy(f"{MANY} commands are under way on this board's bridge already")
            self._running += 1
            try:
                return await self._do(command.verb, caller, message, payload)
            finally:
                self._running -= 1
        except CmError as error:
            return wire.encode_answer(ErrorInfo(error.code, str(error)))
        except OSError as error:
            return wire.encode_answer(ErrorInfo("io", f"the bridge cannot write its record: {error}"))

    async def _do(self, verb: str, caller: str, message: bytes, payload: list[bytes]) -> bytes:
        found = VERBS.get(verb)
        if found is None:
            raise NotFound(f"there is no command do/{verb}; there are {', '.join(VERBS)}")
        if found.topic:
            frames = [found.topic, message, *payload]
            return (await self._relay.forward(frames, self._managed.guest(caller)))[1]
        if verb == "bundle":
            return wire.encode_answer(await self._bundles(wire.decode_fetch(message), caller))
        return wire.encode_answer(await self._step(verb, decode_step(message), caller))

    async def _step(self, verb: str, step: FleetStep, caller: str) -> FleetRecord:
        if verb in ("settle", "vote"):  # the one who asks must not wait for this board's present work
            return self._participant.settle(step) if verb == "settle" else self._participant.vote(step)
        async with self._one:
            if verb == "prepare":
                return await self._participant.prepare(step, caller)
            return await (self._participant.apply(step) if verb == "apply" else self._participant.decide(step))

    async def go_on(self) -> str:
        """Do what the record says is to be done; returns why that is not possible yet, empty if all is done."""
        if self._one.locked():
            return ""
        async with self._one:
            try:
                await self._participant.go_on()
                record = self._participant.record
                if record is not None and not member.ended(record):
                    await self._managed.keep_holding(record)
            except (Unsettled, CmError, OSError) as error:
                return str(error)
        return ""
