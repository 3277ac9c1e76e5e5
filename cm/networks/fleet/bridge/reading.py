# SPDX-License-Identifier: Apache-2.0
"""What can be read from a board: a query's key → requests to the manager → samples under the board's own keys."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cm.client.aio.relay import Relay
from cm.client.core import calls
from cm.client.errors import RequestFailed
from cm.networks.fleet import names
from cm.wire import fleet as wire
from cm.wire.encode import encode_request
from cm.wire.messages import requests as rq
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
        if intersects(names.key(self._board, "status")):
            found.append(Sample(names.key(self._board, "status"), "Status", await self._status()))
        if intersects(names.key(self._board, "config")):
            found.append(await self._config(words))
        for section, ask in (("reg", self._registers), ("irq", self._interrupts)):
            if intersects(names.key(self._board, section, "*")):
                found += await ask(intersects)
        return found

    async def frame(self, stream: str) -> Sample:
        """The next frame of a stream."""
        request = rq.ReadData(stream, 1.0)
        reply = await self._relay.forward(encode_request(request), timeout=_TIMEOUT)
        kind, message = _body(reply[1])
        return Sample(names.key(self._board, "frames", stream), kind, message, b"".join(reply[2:]))

    async def _asked(self, request: rq.Request) -> tuple[str, bytes]:
        reply = await self._relay.forward(encode_request(request), timeout=_TIMEOUT)
        return _body(reply[1])

    async def _config(self, words: Mapping[str, str]) -> Sample:
        config = words.get("config", "")
        request: Any = rq.ReadConfig(config)
        if "list" in words:
            request = rq.ListConfigs()
        elif "plan" in words:
            request = rq.PlanChange(config, words["plan"])
        return Sample(names.key(self._board, "config"), *await self._asked(request))

    async def _registers(self, intersects: Callable[[str], bool]) -> list[Sample]:
        """All readable registers, in one request; those whose keys match are returned."""
        _, values = await self._asked(rq.ReadReg(()))
        each = wire.each_register(values)
        return [
            Sample(key, "RegValues", message)
            for name, message in each
            if intersects(key := names.key(self._board, "reg", name))
        ]

    async def register(self, name: str) -> Sample:
        """One register, or a field, by name."""
        return Sample(names.key(self._board, "reg", name), *await self._asked(rq.ReadReg((name,))))

    async def interrupt(self, name: str) -> Sample:
        """One interrupt's count and time."""
        return Sample(names.key(self._board, "irq", name), *await self._asked(rq.ReadIrq(name)))

    async def _interrupts(self, intersects: Callable[[str], bool]) -> list[Sample]:
        config = await self._relay.ask(calls.describe(), timeout=_TIMEOUT)
        wanted = [i.name for i in config.interrupts if intersects(names.key(self._board, "irq", i.name))]
        return [await self.interrupt(name) for name in wanted]


def _body(reply: bytes) -> tuple[str, bytes]:
    found = wire.body(reply)
    if isinstance(found, ErrorInfo):
        raise RequestFailed(found)
    return found
