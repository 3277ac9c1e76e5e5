# SPDX-License-Identifier: Apache-2.0
"""What a board asks other boards of its fleet: the seats of a change, what is decided."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from cm.errors import InvalidRequest
from cm.networks.fleet import names
from cm.networks.fleet.asking import get
from cm.networks.fleet.change.asks import Ask
from cm.wire.fleet import decode_answer
from cm.wire.fleet_records import encode_step
from cm.wire.messages.fleet import FleetRecord

_TIMEOUT = 5.0


class Network:
    """The fleet as one board sees it."""

    def __init__(self, board: str, session: Any) -> None:
        self._board = board
        self._session = session

    async def ask(self, asks: Sequence[Ask]) -> dict[str, FleetRecord]:
        """Ask all at once, in this board's own name; those that do not answer with a record are left out."""
        answers = await asyncio.gather(*map(self._ask, asks))
        return {ask.board: record for ask, record in zip(asks, answers, strict=True) if record is not None}

    async def _ask(self, ask: Ask) -> FleetRecord | None:
        key = names.command_key(ask.board, ask.verb.value, self._board)
        for answer in await get(self._session, key, encode_step(ask.step), timeout=_TIMEOUT):
            try:
                found = decode_answer(answer.payload) if answer.error is None else None
            except InvalidRequest:
                return None
            if isinstance(found, FleetRecord):
                return found
        return None
