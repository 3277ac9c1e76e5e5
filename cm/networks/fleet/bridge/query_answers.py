# SPDX-License-Identifier: Apache-2.0
"""What the fleet asks of a board: reads and commands, each answered with samples under this board's keys, or an error.

A read is a query's key → requests to the manager → samples. Commands under ``do/`` are passed to the manager in the
caller's name, or done here if they are the fleet's own.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cm.client.core import calls
from cm.client.errors import RequestFailed
from cm.errors import Busy, CmError, NotFound
from cm.networks.fleet import keys
from cm.networks.fleet.bridge.managed_board import ManagedBoard
from cm.networks.fleet.bridge.publishing import encoding
from cm.networks.fleet.keys import VERBS
from cm.networks.fleet.reconciling_board import Board
from cm.networks.fleet.zenoh_session import in_loop, zenoh_module
from cm.wire import fleet as wire
from cm.wire.encode import encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.fleet import BundleState, FetchBundle
from cm.wire.messages.status import ErrorInfo

MANY = 64  # commands that may be under way at once
_TIMEOUT = 30.0  # seconds; a plan reads and checks files
_LOG = logging.getLogger("cm.fleet")


@dataclass(frozen=True, slots=True)
class Sample:
    """A message under a key; for a frame the payload is its bytes, and the message accompanies it."""

    key: str
    kind: str
    message: bytes
    payload: bytes | None = None


@dataclass
class Queries:
    """The queryable of one board. `status`: the last one, with what the bridge adds."""

    name: str
    session: Any
    board: Board
    managed: ManagedBoard
    status: Callable[[], Awaitable[bytes]]
    fetch: Callable[[FetchBundle, str], Awaitable[BundleState]]

    def __post_init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()
        self._room = asyncio.Semaphore(MANY)
        came = zenoh_module().handlers.Callback(in_loop(self._begin), indirect=False)
        self._queryable = self.session.declare_queryable(self._key("**"), came, complete=True)

    def end(self) -> None:
        """Answer nothing more."""
        self._queryable.undeclare()
        for task in self._tasks:
            task.cancel()

    def _begin(self, query: Any) -> None:
        task = asyncio.get_running_loop().create_task(self.answer(query))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _key(self, *parts: str) -> str:
        return keys.key(self.name, *parts)

    async def answer(self, query: Any) -> None:
        """All samples that match, or one error."""
        with query:
            try:
                for sample in await self._samples(query):
                    if sample.payload is None:
                        query.reply(sample.key, sample.message, encoding=encoding(sample.kind))
                    else:
                        query.reply(sample.key, sample.payload, encoding="zenoh/bytes", attachment=sample.message)
            except CmError as error:  # with the board's name in it: an error reply has no key
                refusal = wire.encode_answer(ErrorInfo(error.code, f"{self.name}: {error}"))
                query.reply_err(refusal, encoding=encoding("Reply"))

    async def _samples(self, query: Any) -> list[Sample]:
        wanted = str(query.key_expr)
        command = keys.command_of(wanted)
        if command is not None:
            return [Sample(self._key(keys.command(*command)), "Reply", await self._command(*command, query))]
        parts = wanted.split("/")
        if len(parts) == 4 and parts[2] in ("reg", "irq", "frames") and not keys.WILD & set(parts[3]):
            return [await self._one(*parts[2:])]
        expression, words = zenoh_module().KeyExpr, dict(query.parameters)
        found = await self._matching(lambda *rest: bool(query.key_expr.intersects(expression(self._key(*rest)))), words)
        if not found and not keys.WILD & set(wanted):  # no answer at all would look like an absent board
            raise NotFound(f"there is nothing under {wanted}")
        return found

    # ---- reads ------------------------------------------------------------------------------

    async def _matching(self, asked: Callable[..., bool], words: Mapping[str, str]) -> list[Sample]:
        """Of all keys of this board those that are `asked` for; `words` are the selector's parameters."""
        found = []
        if asked("status"):
            found.append(Sample(self._key("status"), "Status", await self.status()))
        if asked("config"):
            found.append(await self._manager_says(_about_config(words), "config"))
        if asked("reg", "*"):
            every = (await self._manager_says(rq.ReadReg(()), "reg")).message
            each = [(name, value) for name, value in wire.each_register(every) if asked("reg", name)]
            found += [Sample(self._key("reg", name), "RegValues", value) for name, value in each]
        if asked("irq", "*"):
            config = await self.managed.relay.ask(calls.describe(), timeout=_TIMEOUT)
            found += [await self._one("irq", i.name) for i in config.interrupts if asked("irq", i.name)]
        return found

    async def _one(self, section: str, name: str) -> Sample:
        """A register or a field, an interrupt's count and time, or the next frame of a stream, by its name."""
        requests: dict[str, rq.Request] = {
            "reg": rq.ReadReg((name,)), "irq": rq.ReadIrq(name), "frames": rq.ReadData(name, 1.0)
        }  # fmt: skip
        return await self._manager_says(requests[section], section, name)

    async def _manager_says(self, request: rq.Request, *parts: str) -> Sample:
        reply = await self.managed.relay.forward(encode_request(request), timeout=_TIMEOUT)
        found = wire.body(reply[1])
        if isinstance(found, ErrorInfo):
            raise RequestFailed(found)
        return Sample(self._key(*parts), *found, b"".join(reply[2:]) if isinstance(request, rq.ReadData) else None)

    # ---- commands ---------------------------------------------------------------------------

    async def _command(self, verb: str, caller: str, query: Any) -> bytes:
        """Carry it out; returns a serialised Reply, also for an error."""
        message = bytes(query.payload) if query.payload is not None else b""
        beside: list[bytes] = []
        if query.attachment is not None:  # data travel beside their message, as everywhere
            message, beside = bytes(query.attachment), [message]
        try:
            if self._room.locked():
                raise Busy(f"{MANY} commands are under way on this board's bridge already")
            async with self._room:
                return await self._done(verb, caller or keys.NOBODY, message, beside)
        except CmError as error:
            return wire.encode_answer(ErrorInfo(error.code, str(error)))
        except OSError as error:
            return wire.encode_answer(ErrorInfo("io", f"the bridge cannot write its notes: {error}"))

    async def _done(self, verb: str, caller: str, message: bytes, beside: list[bytes]) -> bytes:
        if verb not in VERBS:
            raise NotFound(f"there is no command do/{verb}; there are {', '.join(VERBS)}")
        if topic := VERBS[verb].topic:
            return (await self.managed.relay.forward([topic, message, *beside], self.managed.guest(caller)))[1]
        if verb == "bundle":
            return wire.encode_answer(await self.fetch(wire.decode_fetch(message), caller))
        return wire.encode_answer(await self.board.step(verb, wire.decode_step(message), caller))


def _about_config(words: Mapping[str, str]) -> rq.Request:
    if "list" in words:
        return rq.ListConfigs()
    config = words.get("config", "")
    return rq.PlanChange(config, words["plan"]) if "plan" in words else rq.ReadConfig(config)
