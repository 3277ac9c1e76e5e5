# SPDX-License-Identifier: Apache-2.0
"""A bridge's connections to its manager, one for each guest; all calls that wait in them end when they are closed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cm.client.board import Board
from cm.client.errors import BoardClosed
from cm.errors import CmError

_KEPT = 16  # connections of guests that are kept open

Connect = Callable[[str], Board]
"""Makes a connection in the name of a guest; of the bridge's own where the name is empty."""


class BridgeEnds(CmError):
    """The bridge ends, and waits for no answer of the manager any more."""

    code = "closed"

    def __init__(self) -> None:
        super().__init__("the bridge ends; a change that the manager has begun goes on")


class Connections:
    """Threads may share it."""

    def __init__(self, connect: Connect) -> None:
        self._connect = connect
        self._kept: OrderedDict[str, Board] = OrderedDict()
        self._own: set[Board] = set()
        self._lock = threading.Lock()
        self._over = False

    def kept(self, guest: str) -> Board:
        """A guest's, for short requests. It stays ours. Raises BridgeEnds, and what connecting raises."""
        with self._lock:
            if (board := self._kept.get(guest)) is not None:
                self._kept.move_to_end(guest)
                return board
        made = self._made(guest)
        with self._lock:
            board = self._kept.setdefault(guest, made)
            spare = [] if board is made else [made]  # another thread was faster
            if len(self._kept) > _KEPT:
                spare.append(self._kept.popitem(last=False)[1])
        for each in spare:
            self._drop(each)
        return board

    @contextmanager
    def own(self, guest: str) -> Iterator[Board]:
        """One for a call that takes long: others are answered meanwhile. Raises as `kept`."""
        board = self._made(guest)
        try:
            yield board
        finally:
            self._drop(board)

    @contextmanager
    def ending(self) -> Iterator[None]:
        """What waits within, and is freed by `close`, raises BridgeEnds."""
        try:
            yield
        except BoardClosed:
            if not self._over:
                raise
            raise BridgeEnds from None

    def _made(self, guest: str) -> Board:
        self._check()
        board = self._connect(guest)  # outside the lock: a manager may take its time
        with self._lock:
            self._own.add(board)
        try:
            self._check()
        except BridgeEnds:
            self._drop(board)
            raise
        return board

    def _check(self) -> None:
        if self._over:
            raise BridgeEnds

    def _drop(self, board: Board) -> None:
        with self._lock:
            self._own.discard(board)
        board.close()

    def close(self) -> None:
        """Disconnect, and free who waits; twice is fine."""
        with self._lock:
            self._over = True
            boards, self._own = self._own, set()
            self._kept = OrderedDict()
        for board in boards:
            board.close()
