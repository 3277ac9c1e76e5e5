# SPDX-License-Identifier: Apache-2.0
"""Which boards are present: their tokens, followed from the connection's first moment to its end.

They are not queried each time: while a session has a subscriber to tokens, and for a while after one was undeclared, a
query for them may leave out some, or all (seen with zenoh 1.10.2, through a router). What the subscriber gets is
complete.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any

from cm.networks.fleet import keys
from cm.networks.fleet.network import zenoh_module

_FIRST = 2.0  # seconds for the tokens that existed before
Listener = Callable[[str, bool], None]  # a board, and whether it is there now


class Presence:
    """The presence in one session; made by `begin`, and never undeclared."""

    def __init__(self, session: Any) -> None:
        self._session = session
        self._boards: set[str] = set()
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._listeners: set[Listener] = set()
        self._subscriber: Any = None

    async def begin(self, timeout: float) -> None:
        """Follow from now on; returns when the present boards are known."""
        await asyncio.to_thread(self._begin, timeout)

    def _begin(self, timeout: float) -> None:
        key = keys.key("*", "alive")
        replies = self._session.liveliness().get(key, timeout=timeout)
        before = {keys.board_of(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None}
        self._subscriber = self._session.liveliness().declare_subscriber(key, self._came, history=True)
        end = time.monotonic() + _FIRST
        while not before <= self._boards and time.monotonic() < end:
            self._changed.wait(end - time.monotonic())
            self._changed.clear()

    def _came(self, sample: Any) -> None:
        """In zenoh's thread."""
        board = keys.board_of(str(sample.key_expr))
        there = sample.kind != zenoh_module().SampleKind.DELETE
        with self._lock:
            (self._boards.add if there else self._boards.discard)(board)
            listeners = tuple(self._listeners)
        self._changed.set()
        for tell in listeners:
            tell(board, there)

    def boards(self) -> tuple[str, ...]:
        """The boards that are present, sorted."""
        with self._lock:
            return tuple(sorted(self._boards))

    def listen(self, tell: Listener) -> Callable[[], None]:
        """Be told which boards are present, come and go, in any thread; call the returned function to end this."""
        with self._lock:
            self._listeners.add(tell)
            there = tuple(self._boards)
        for board in there:
            tell(board, True)
        return lambda: self._listeners.discard(tell)
