# SPDX-License-Identifier: Apache-2.0
"""Requests from the other side of a bridge, made in the caller's name.

A guest has a connection of its own to the manager; all calls that wait in them end when they are closed.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

from cm.client.board import Board
from cm.client.core import calls
from cm.client.core.calls import Call
from cm.client.core.value_checks import register_write
from cm.client.errors import BoardClosed
from cm.errors import CmError, Forbidden, InvalidRequest
from cm.networks.bridge.records import Caller
from cm.networks.bridge.streams import FrameWriter
from cm.wire.messages.requests import WriteReg
from cm.wire.messages.status import PlanInfo, Progress, RegValues

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


_T = TypeVar("_T")
WRITES = ("modes", "registers", "frames")  # what callers may change


def writes_named(text: str) -> frozenset[str]:
    """Some of `WRITES`, as a user names them: ``modes,registers``, ``all``, or nothing. Raises InvalidRequest."""
    named = frozenset(filter(None, (word.strip() for word in text.split(","))))
    if named == {"all"}:
        return frozenset(WRITES)
    if unknown := named.difference(WRITES):
        raise InvalidRequest(f"write {', '.join(sorted(unknown))}: what is known is {', '.join(WRITES)}, or all")
    return named


class Commands:
    """Requests of callers; threads may share it. Every call raises CmError with what was refused, and why.

    `writes`: which of `WRITES` callers may change, if the manager lets the bridge; what is not among them raises
    Forbidden. Calls that wait when it is closed raise BridgeEnds.
    """

    def __init__(self, connect: Connect, writes: Collection[str] = ()) -> None:
        self._connections = Connections(connect)
        self.writes = frozenset(writes)

    def _must(self, what: str) -> None:
        if what not in self.writes:
            raise Forbidden(
                f"this bridge only observes {what}: what its nodes may change is named when it starts, as write {what}"
            )

    def board(self, caller: Caller) -> Board:
        """The connection for a caller's short requests, which remains ours to close."""
        return self._connections.kept(caller.guest)

    def _ask(self, caller: Caller, call: Call[_T]) -> _T:
        with self._connections.ending():
            return self.board(caller).ask(call)

    def plan(self, caller: Caller, config: str = "", mode: str = "") -> PlanInfo:
        """What going to a mode would do; touches nothing."""
        with self._connections.ending():
            return self.board(caller).plan(mode, config)

    def change(
        self,
        caller: Caller,
        config: str = "",
        mode: str = "",
        *,
        force: bool = False,
        progress: Callable[[Progress], None] | None = None,
    ) -> float:
        """Go to a mode and wait; returns the seconds it took.

        It uses a connection of its own, so that others are answered meanwhile.
        """
        self._must("modes")
        with self._connections.ending(), self._connections.own(caller.guest) as board:
            return board.load(
                config, mode, progress=progress or False, timeout=None, queue=True, force=force, lease=caller.lease
            )

    def cancel(self, caller: Caller) -> None:
        """Cancel the change that runs."""
        self._must("modes")
        self._ask(caller, calls.cancel())

    def read_registers(self, caller: Caller, *names: str) -> RegValues:
        """Registers or fields by name; all that can be read if none is named."""
        return self._ask(caller, calls.read_registers(names))

    def write_registers(
        self, caller: Caller, values: Mapping[str, int | str], masks: Mapping[str, int] | None = None
    ) -> RegValues:
        """Several registers or fields in order, all checked before the first is written.

        `masks`: for a register named there, only these bits are written.
        """
        self._must("registers")
        writes = [register_write(name, value) for name, value in values.items()]
        masked = [
            replace(write, mask=masks[write.name]) if masks and write.name in masks else write for write in writes
        ]
        call = calls.write_registers({}, caller.lease)
        return self._ask(caller, replace(call, request=WriteReg(tuple(masked), caller.lease)))

    def writer(self, caller: Caller, stream: str) -> FrameWriter:
        """Frames towards the hardware; the caller closes it."""
        self._must("frames")
        return FrameWriter(self.board(caller), stream, caller.lease)

    def close(self) -> None:
        """Disconnect, and free who waits; twice is fine."""
        self._connections.close()
