# SPDX-License-Identifier: Apache-2.0
"""Queries of the network, answered in the loop: each with samples under this board's keys, or with an error."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from typing import Any

from cm.errors import CmError, NotFound
from cm.networks.fleet import names
from cm.networks.fleet.bridge.commands import Commands
from cm.networks.fleet.bridge.publishing import encoding
from cm.networks.fleet.bridge.reading import Reader, Sample
from cm.networks.fleet.network import zenoh_module
from cm.networks.fleet.verbs import VERBS
from cm.wire import fleet as wire
from cm.wire.json_text import from_json, to_json
from cm.wire.messages.status import ErrorInfo

_LOG = logging.getLogger("cm.fleet")
JSON = "application/json"


class Queries:
    """The queryable of one board."""

    def __init__(self, board: str, session: Any, reader: Reader, commands: Commands) -> None:
        self._board = board
        self._reader = reader
        self._commands = commands
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._expression = zenoh_module().KeyExpr
        self._queryable = session.declare_queryable(f"{names.ROOT}/{board}/**", self._came, complete=True)

    def end(self) -> None:
        """Answer nothing more."""
        self._queryable.undeclare()
        for task in self._tasks:
            task.cancel()

    def _came(self, query: Any) -> None:
        """In zenoh's thread."""
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._begin, query)

    def _begin(self, query: Any) -> None:
        task = self._loop.create_task(self._answer(query))
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
        command = names.command_of(wanted)
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

    async def _command(self, command: names.Command, query: Any, as_json: bool) -> Sample:
        key = names.command_key(self._board, command.verb, command.caller)
        payload = bytes(query.payload) if query.payload is not None else b""
        data: list[bytes] = []
        if query.attachment is not None:  # data travel beside their message, as everywhere
            payload, data = bytes(query.attachment), [payload]
        if as_json and command.verb in VERBS and payload:
            payload = from_json(VERBS[command.verb].message, payload)
        return Sample(key, "Reply", await self._commands.do(command, payload, data))

    async def _read(self, wanted: str, expression: Any, words: dict[str, str]) -> list[Sample]:
        parts = wanted.split("/")
        if len(parts) == 4 and not names.WILD & set(parts[3]):  # one thing by its name
            named = {"reg": self._reader.register, "irq": self._reader.interrupt, "frames": self._reader.frame}
            if parts[2] in named:
                return [await named[parts[2]](parts[3])]
        found = await self._reader.answers(lambda key: bool(expression.intersects(self._expression(key))), words)
        if not found and not names.WILD & set(wanted):  # no answer at all would look like an absent board
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
