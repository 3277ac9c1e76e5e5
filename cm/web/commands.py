# SPDX-License-Identifier: Apache-2.0
"""What a page may request: reading always; changes only if the server was started with --control."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from cm.client.aio.board import Board
from cm.errors import CmError, InvalidRequest
from cm.web.hub import Hub
from cm.wire.messages.json_values import plain

Words = Mapping[str, Any]


class NotAllowed(CmError):
    """The page may only look."""

    code = "read_only"


class Disconnected(CmError):
    """There is no manager to ask."""

    code = "connection_lost"


class Commands:
    """Carries out what pages ask for."""

    def __init__(self, hub: Hub, control: bool) -> None:
        self._hub = hub
        self._control = control
        self._looks: dict[str, Callable[[Board, Words], Awaitable[Any]]] = {
            "plan": self._plan,
            "read": self._read,
            "map": self._map,
        }
        self._changes: dict[str, Callable[[Board, Words], Awaitable[Any]]] = {
            "mode": self._mode,
            "cancel": self._cancel,
            "write": self._write,
        }

    async def do(self, what: str, words: Words) -> Any:
        """The answer, as JSON has it. Raises CmError."""
        if what in self._changes and not self._control:
            raise NotAllowed("this page may only look: it was started without --control")
        handler = self._looks.get(what) or self._changes.get(what)
        if handler is None:
            raise InvalidRequest(f"a page may ask for {', '.join([*self._looks, *self._changes])}, not for {what!r}")
        if self._hub.board is None:
            raise Disconnected("the configuration manager is not there")
        return await handler(self._hub.board, words)

    async def _plan(self, board: Board, words: Words) -> Any:
        return plain(await board.plan(_text(words, "mode"), _text(words, "config")))

    async def _read(self, board: Board, words: Words) -> None:
        names = words.get("names", [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InvalidRequest("names: a list of registers is wanted")
        await self._hub.read_registers(board, tuple(names))

    async def _map(self, board: Board, words: Words) -> str:
        """A region's frames as SVG, red where the last check found them wrong; with `check`, one is made first."""
        from cm.formats.xray.drawing import columns_of, region_picture, with_names, wrong_words

        region, check = _text(words, "region"), words.get("check") is True
        if check and not self._control:
            raise NotAllowed("this page may only look: it was started without --control")
        if check:
            await board.check_region(region)
        found = await board.map_region(region)
        columns = columns_of(found)
        known = await asyncio.to_thread(with_names, found.device, columns)  # half a second for the first
        red = wrong_words((one.far, one.bits) for one in found.wrong)
        return region_picture(found, known or columns, red, known is not None)

    async def _mode(self, board: Board, words: Words) -> float:
        return await board.load(_text(words, "config"), _text(words, "mode"), queue=False)

    async def _cancel(self, board: Board, _: Words) -> None:
        await board.cancel()

    async def _write(self, board: Board, words: Words) -> None:
        value = words.get("value")
        if isinstance(value, bool) or not isinstance(value, (int, str)):
            raise InvalidRequest(f"value: an integer, or a value's name, is wanted, not {value!r}")
        await board.registers.write({_text(words, "name"): value})


def _text(words: Words, key: str) -> str:
    value = words.get(key, "")
    if not isinstance(value, str):
        raise InvalidRequest(f"{key}: text is wanted, not {value!r}")
    return value
