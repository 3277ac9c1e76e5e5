# SPDX-License-Identifier: Apache-2.0
"""Which boards are present, and what they say: tokens, followed from the connection's first moment on, and statuses.

Tokens are not queried each time: while a session has a subscriber to tokens, and for a while after one was
undeclared, a query for them may leave out some, or all (seen with zenoh 1.10.2, through a router). What the subscriber
gets is complete.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from cm.networks.fleet import keys
from cm.networks.fleet.zenoh_session import in_loop, zenoh_module
from cm.wire import fleet as wire
from cm.wire.messages.fleet import BoardStatus

_FIRST = 2.0  # seconds for the tokens that existed before
_SILENCE = 10.0  # seconds without a status after which a board counts as gone, as a bridge does that hangs
_WAITING = 1000  # statuses


class Presence:
    """The presence in one session; made by `begin`, and never undeclared. For the loop in which that is awaited."""

    def __init__(self) -> None:
        self.boards: set[str] = set()
        self._gone: set[Callable[[str], None]] = set()  # who is told of a board that has gone

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
        for tell in tuple(self._gone):
            tell(board)

    @asynccontextmanager
    async def statuses(self, session: Any, boards: str) -> AsyncIterator[AsyncIterator[tuple[str, BoardStatus | None]]]:
        """The statuses of one board, or of ``*``, as they come; None for one that has gone, or says nothing."""
        come: asyncio.Queue[tuple[str, bytes | None]] = asyncio.Queue()
        heard: dict[str, float] = {}  # when, of each board

        def put(board: str, status: bytes | None) -> None:
            if status is None:
                heard.pop(board, None)
            else:
                heard[board] = time.monotonic()
            if come.qsize() >= _WAITING:
                come.get_nowait()
            come.put_nowait((board, status))

        def gone(board: str) -> None:
            if boards in ("*", board):
                put(board, None)

        async def each() -> AsyncIterator[tuple[str, BoardStatus | None]]:
            while True:
                board, status = await come.get()
                yield board, None if status is None else wire.board_status(status)

        async def look() -> None:
            while True:
                await asyncio.sleep(_SILENCE / 10)
                silent = time.monotonic() - _SILENCE
                for board in [name for name, at in heard.items() if at < silent]:
                    put(board, None)

        tell, looking = in_loop(put), asyncio.create_task(look())
        subscriber = session.declare_subscriber(
            keys.key(boards, "status"), lambda each: tell(keys.board_of(str(each.key_expr)), bytes(each.payload))
        )
        self._gone.add(gone)
        try:
            yield each()
        finally:
            self._gone.discard(gone)
            subscriber.undeclare()
            looking.cancel()
