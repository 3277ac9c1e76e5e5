# SPDX-License-Identifier: Apache-2.0
"""Register reads that repeat an earlier request byte for byte.

A program that polls a register sends the same request again and again. Its bytes are decoded once for each mode;
after that only the access itself, and the values in a kept reply, are new.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cm.errors import InvalidRequest
from cm.manager.access.register_view import Prepared
from cm.wire.decode import decode_request
from cm.wire.encode import RegisterReply
from cm.wire.messages.requests import ReadReg
from cm.wire.request_table import Frame

_LONGEST, _KEPT = 256, 256  # bytes of a request that is kept, and how many are


class ReadCache:
    """Answers repeated requests. For one thread."""

    def __init__(self, prepare: Callable[[tuple[str, ...]], Prepared | None]) -> None:
        self._prepare = prepare
        self._kept: dict[bytes, tuple[Prepared, RegisterReply]] = {}

    def learn(self, frames: Sequence[Frame]) -> None:
        """Remember a request (topic, message) that was answered the long way."""
        prepared = self._understand(frames) if len(frames) == 2 and len(frames[1]) <= _LONGEST else None
        if prepared is None:
            return
        if len(self._kept) >= _KEPT:
            self._kept.clear()
        reply = RegisterReply(prepared.names, prepared.fields, prepared.config_name, prepared.mode)
        self._kept[bytes(frames[1])] = prepared, reply

    def _understand(self, frames: Sequence[Frame]) -> Prepared | None:
        try:
            request = decode_request(frames)
        except InvalidRequest:
            return None
        return self._prepare(request.names) if isinstance(request, ReadReg) else None

    def answer(self, message: bytes, sequence: int) -> bytes | None:
        """The Reply message, or None: it has to be answered the long way. Raises what the device raises."""
        kept = self._kept.get(message)
        if kept is None:
            return None
        prepared, reply = kept
        values = prepared.values()
        if values is None:
            del self._kept[message]
            return None
        return reply.encode(values, sequence)
