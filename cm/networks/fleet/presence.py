# SPDX-License-Identifier: Apache-2.0
"""Which boards are present: their tokens, followed from the connection's first moment to its end.

They are not queried each time: while a session has a subscriber to tokens, and for a while after one was undeclared, a
query for them may leave out some, or all (seen with zenoh 1.10.2, through a router). What the subscriber gets is
complete.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from cm.networks.fleet import keys
from cm.networks.fleet.zenoh_session import in_loop, zenoh_module

_FIRST = 2.0  # seconds for the tokens that existed before


class Presence:
    """The presence in one session; made by `begin`, and never undeclared. For the loop in which that is awaited."""

    def __init__(self) -> None:
        self.boards: set[str] = set()
        self.gone: set[Callable[[str], None]] = set()  # who is told of a board that has gone

    async def begin(self, session: Any, timeout: float) -> None:
        """Follow from now on; returns when the present boards are known."""
        key, tokens = keys.key("*", "alive"), session.liveliness()
        replies = await asyncio.to_thread(list, tokens.get(key, timeout=timeout))
        before = {keys.board_of(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None}
        came = zenoh_module().handlers.Callback(in_loop(self._came), indirect=False)
        self._subscriber = tokens.declare_subscriber(key, came, history=True)
        end = time.monotonic() + _FIRST
        while not before <= self.boards and time.monotonic() < end:
            await asyncio.sleep(0.001)

    def _came(self, sample: Any) -> None:
        board = keys.board_of(str(sample.key_expr))
        if sample.kind != zenoh_module().SampleKind.DELETE:
            self.boards.add(board)
            return
        self.boards.discard(board)
        for tell in tuple(self.gone):
            tell(board)
