# SPDX-License-Identifier: Apache-2.0
"""Commands under ``do/``: passed to the manager in the caller's name, or done here if they are the fleet's own."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from cm.client.aio.relay import Relay
from cm.errors import Busy, CmError, NotFound
from cm.networks.fleet import names
from cm.networks.fleet.board import Board
from cm.networks.fleet.bridge.managed import ManagedBoard
from cm.networks.fleet.verbs import VERBS
from cm.wire import fleet as wire
from cm.wire.messages.fleet import BundleState, FetchBundle, FleetState, FleetStep
from cm.wire.messages.status import ErrorInfo

MANY = 64  # commands that may be under way at once

FetchAndImport = Callable[[FetchBundle, str], Awaitable[BundleState]]


class Commands:
    """Of one board."""

    def __init__(self, relay: Relay, board: Board, managed: ManagedBoard, bundles: FetchAndImport) -> None:
        self._relay = relay
        self._board = board
        self._managed = managed
        self._bundles = bundles
        self._one = asyncio.Lock()  # what the board does for its fleet, one after the other
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
            return wire.encode_answer(ErrorInfo("io", f"the bridge cannot write its notes: {error}"))

    async def _do(self, verb: str, caller: str, message: bytes, payload: list[bytes]) -> bytes:
        found = VERBS.get(verb)
        if found is None:
            raise NotFound(f"there is no command do/{verb}; there are {', '.join(VERBS)}")
        if found.topic:
            frames = [found.topic, message, *payload]
            return (await self._relay.forward(frames, self._managed.guest(caller)))[1]
        if verb == "bundle":
            return wire.encode_answer(await self._bundles(wire.decode_fetch(message), caller))
        return wire.encode_answer(await self._step(verb, wire.decode_step(message), caller))

    async def _step(self, verb: str, step: FleetStep, caller: str) -> FleetState:
        async with self._one:
            if verb == "prepare":
                return await self._board.prepare(step, caller)
            if verb == "apply":
                return await self._board.apply(step)
            return await self._board.look(again=step.id == names.AGAIN)

    async def look(self) -> str:
        """Do what is wanted of the board now; returns why that is not possible yet, empty if all is done."""
        async with self._one:
            try:
                return (await self._board.look()).store_error
            except (CmError, OSError) as error:
                return str(error)
