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

from cm.client.aio.relay import Relay
from cm.client.core import calls
from cm.client.errors import RequestFailed
from cm.errors import Busy, CmError, NotFound
from cm.networks.fleet import keys
from cm.networks.fleet.board import Board
from cm.networks.fleet.bridge.managed import ManagedBoard
from cm.networks.fleet.bridge.publishing import encoding
from cm.networks.fleet.keys import VERBS
from cm.networks.fleet.network import in_loop, zenoh_module
from cm.wire import fleet as wire
from cm.wire.encode import encode_request
from cm.wire.json_text import from_json, to_json
from cm.wire.messages import requests as rq
from cm.wire.messages.fleet import BundleState, FetchBundle, FleetState, FleetStep
from cm.wire.messages.status import ErrorInfo

_TIMEOUT = 30.0  # seconds; a plan reads and checks files


@dataclass(frozen=True, slots=True)
class Sample:
    """A message under a key; for a frame the payload is its bytes, and the message accompanies it."""

    key: str
    kind: str
    message: bytes
    payload: bytes | None = None


class Reader:
    """Answers queries for one board. Raises CmError, which the caller turns into an error reply."""

    def __init__(self, board: str, relay: Relay, status: Callable[[], Awaitable[bytes]]) -> None:
        self._board = board
        self._relay = relay
        self._status = status

    async def answers(self, intersects: Callable[[str], bool], words: Mapping[str, str]) -> list[Sample]:
        """The answers for all keys of this board that match the query; `words` are the selector's parameters."""
        found: list[Sample] = []
        if intersects(keys.key(self._board, "status")):
            found.append(Sample(keys.key(self._board, "status"), "Status", await self._status()))
        if intersects(keys.key(self._board, "config")):
            found.append(await self._config(words))
        for section, ask in (("reg", self._registers), ("irq", self._interrupts)):
            if intersects(keys.key(self._board, section, "*")):
                found += await ask(intersects)
        return found

    async def one(self, section: str, name: str) -> Sample:
        """A register or a field, an interrupt's count and time, or the next frame of a stream, by its name."""
        requests: dict[str, rq.Request] = {
            "reg": rq.ReadReg((name,)), "irq": rq.ReadIrq(name), "frames": rq.ReadData(name, 1.0)
        }  # fmt: skip
        return Sample(keys.key(self._board, section, name), *await self._asked(requests[section]))

    async def _asked(self, request: rq.Request) -> tuple[str, bytes, bytes | None]:
        """The message of the answer, and what lies beside it."""
        reply = await self._relay.forward(encode_request(request), timeout=_TIMEOUT)
        found = wire.body(reply[1])
        if isinstance(found, ErrorInfo):
            raise RequestFailed(found)
        return *found, b"".join(reply[2:]) if isinstance(request, rq.ReadData) else None

    async def _config(self, words: Mapping[str, str]) -> Sample:
        config = words.get("config", "")
        request: Any = rq.ReadConfig(config)
        if "list" in words:
            request = rq.ListConfigs()
        elif "plan" in words:
            request = rq.PlanChange(config, words["plan"])
        return Sample(keys.key(self._board, "config"), *await self._asked(request))

    async def _registers(self, intersects: Callable[[str], bool]) -> list[Sample]:
        """All readable registers, in one request; those whose keys match are returned."""
        each = wire.each_register((await self._asked(rq.ReadReg(())))[1])
        return [
            Sample(key, "RegValues", message)
            for name, message in each
            if intersects(key := keys.key(self._board, "reg", name))
        ]

    async def _interrupts(self, intersects: Callable[[str], bool]) -> list[Sample]:
        config = await self._relay.ask(calls.describe(), timeout=_TIMEOUT)
        wanted = [i.name for i in config.interrupts if intersects(keys.key(self._board, "irq", i.name))]
        return [await self.one("irq", name) for name in wanted]


MANY = 64  # commands that may be under way at once

FetchAndImport = Callable[[FetchBundle, str], Awaitable[BundleState]]


class Commands:
    """Of one board."""

    def __init__(self, relay: Relay, board: Board, managed: ManagedBoard, bundles: FetchAndImport) -> None:
        self.wake = asyncio.Event()  # set: the board has to be looked at, if no command does that meanwhile
        self._relay = relay
        self._board = board
        self._managed = managed
        self._bundles = bundles
        self._one = asyncio.Lock()  # what the board does for its fleet, one after the other
        self._running = 0

    async def do(self, command: keys.Command, message: bytes, payload: list[bytes]) -> bytes:
        """Carry it out; returns a serialised Reply, also for an error."""
        caller = command.caller or keys.NOBODY
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
            self.wake.clear()
            if verb == "apply":
                return await self._board.apply(step)
            if verb == "prepare":
                return await self._board.prepare(step, caller)
            return await self._board.look(step.id == keys.AGAIN, step)

    def remind(self) -> None:
        """Have the board looked at, if there is something to do and nobody is at it."""
        if self._board.unsettled and not self._one.locked():
            self.wake.set()

    async def look(self) -> str:
        """Do what is wanted of the board now; returns why that is not possible yet, empty if all is done."""
        async with self._one:
            self.wake.clear()
            try:
                return (await self._board.look()).store_error
            except (CmError, OSError) as error:
                return str(error)


_LOG = logging.getLogger("cm.fleet")
JSON = "application/json"


class Queries:
    """The queryable of one board."""

    def __init__(self, board: str, session: Any, reader: Reader, commands: Commands) -> None:
        self._board = board
        self._reader = reader
        self._commands = commands
        self._tasks: set[asyncio.Task[None]] = set()
        self._expression = zenoh_module().KeyExpr
        came = zenoh_module().handlers.Callback(in_loop(self._begin), indirect=False)
        self._queryable = session.declare_queryable(f"{keys.ROOT}/{board}/**", came, complete=True)

    def end(self) -> None:
        """Answer nothing more."""
        self._queryable.undeclare()
        for task in self._tasks:
            task.cancel()

    def _begin(self, query: Any) -> None:
        task = asyncio.get_running_loop().create_task(self._answer(query))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, query: Any) -> None:
        words = dict(query.parameters)
        as_json = words.get("format") == "json" or str(query.encoding or "").startswith(JSON)
        try:
            with query:
                await self._reply(query, words, as_json)
        except CmError as error:
            _LOG.info("%s: %s", query.key_expr, error)

    async def _reply(self, query: Any, words: dict[str, str], as_json: bool) -> None:
        wanted = str(query.key_expr)
        command = keys.command_of(wanted)
        try:
            if command is not None:
                return self._put(query, await self._command(command, query, as_json), as_json)
            samples = await self._read(wanted, query.key_expr, words)
        except CmError as error:  # with the board's name in it: an error reply has no key
            answer = wire.encode_answer(ErrorInfo(error.code, f"{self._board}: {error}"))
            query.reply_err(*_shown("Reply", answer, as_json)[:1], encoding=_shown("Reply", answer, as_json)[1])
            return None
        for sample in samples:
            self._put(query, sample, as_json)
        return None

    async def _command(self, command: keys.Command, query: Any, as_json: bool) -> Sample:
        key = keys.command_key(self._board, command.verb, command.caller)
        payload = bytes(query.payload) if query.payload is not None else b""
        data: list[bytes] = []
        if query.attachment is not None:  # data travel beside their message, as everywhere
            payload, data = bytes(query.attachment), [payload]
        if as_json and command.verb in VERBS and payload:
            payload = from_json(VERBS[command.verb].message, payload)
        return Sample(key, "Reply", await self._commands.do(command, payload, data))

    async def _read(self, wanted: str, expression: Any, words: dict[str, str]) -> list[Sample]:
        parts = wanted.split("/")
        if len(parts) == 4 and parts[2] in ("reg", "irq", "frames") and not keys.WILD & set(parts[3]):
            return [await self._reader.one(*parts[2:])]
        found = await self._reader.answers(lambda key: bool(expression.intersects(self._expression(key))), words)
        if not found and not keys.WILD & set(wanted):  # no answer at all would look like an absent board
            raise NotFound(f"there is nothing under {wanted}")
        return found

    def _put(self, query: Any, sample: Sample, as_json: bool) -> None:
        shown, kind = _shown(sample.kind, sample.message, as_json)
        if sample.payload is None:
            query.reply(sample.key, shown, encoding=kind)
        else:
            query.reply(sample.key, sample.payload, encoding="zenoh/bytes", attachment=shown)


def _shown(kind: str, message: bytes, as_json: bool) -> tuple[bytes, str]:
    return (to_json(kind, message).encode(), JSON) if as_json else (message, encoding(kind))
