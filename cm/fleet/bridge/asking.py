# SPDX-License-Identifier: Apache-2.0
"""What a board asks of others of its fleet: the seat, what was decided."""

from __future__ import annotations

import asyncio
from typing import Any

from cm.errors import InvalidRequest
from cm.fleet import names
from cm.messages.fleet import FleetRecord, FleetStep
from cm.wire.fleet import decode_answer, encode_step

_TIMEOUT = 5.0


class Network:
    """The fleet as one board sees it."""

    def __init__(self, board: str, session: Any) -> None:
        self._board = board
        self._session = session

    async def asked(self, seat: str, change: str, caller: str) -> FleetRecord | None:  # noqa: ARG002
        """The seat's record, asked for in this board's own name; None where it does not answer."""
        return await asyncio.to_thread(self._ask, names.command_key(seat, "settle", self._board), change)

    def _ask(self, key: str, change: str) -> FleetRecord | None:
        for reply in self._session.get(key, payload=encode_step(FleetStep(change)), timeout=_TIMEOUT):
            if reply.ok is not None:
                try:
                    answer = decode_answer(bytes(reply.ok.payload))
                except InvalidRequest:
                    return None
                return answer if isinstance(answer, FleetRecord) else None
        return None
