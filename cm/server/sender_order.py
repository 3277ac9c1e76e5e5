# SPDX-License-Identifier: Apache-2.0
"""Requests of one sender take effect in the order in which they were sent. The loop's thread.

A change of mode, a configuration that is stored and a memory that is written take time, and the manager goes on serving
meanwhile. A later write from the same sender waits if one of them would overwrite or refuse it, and what comes after
that write waits too. No sender waits for another's requests. A sender is a connection to the ROUTER; all clients of the
SUB socket are one sender together.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator
from enum import Enum
from typing import Any

from cm.errors import Busy, InvalidRequest
from cm.frozen import dataclass, field
from cm.manager.execution.worker import Change
from cm.manager.manager import Manager
from cm.server.client_quotas import Client
from cm.server.error_replies import refusal
from cm.server.rights.required_rights import Right
from cm.wire.messages.requests import WriteReg
from cm.wire.messages.status import Reply

Work = Generator[object, None, Reply]  # in steps, each in its turn; what it returns is the answer
_MOST = 256  # requests of one sender that wait


class Waits(Enum):
    """What a request of a kind waits for, of those that its sender sent before."""

    NEVER = "for nothing"
    IN_LINE = "for those that wait, and for long ones for registers"
    TO_WRITE = "for changes that write what it writes, too"
    TO_CHANGE = "for configurations that are stored and memories that are written, too"


class Holds(Enum):
    """What a request is as long as it is under way, for those behind it."""

    LONG = "registers, piece by piece"
    STORES = "a configuration that is stored"
    WRITES = "a memory that is written"


@dataclass(frozen=True, slots=True)
class Row:
    """A kind of request. Its handler is given services, an `Asked` and the request, and returns the reply, or `Work`,
    or None if it answers later. It says what the request `holds` before it returns.
    """

    kind: type
    handler: Callable[[Any, Asked, Any], Reply | Work | None]
    right: Right
    waits: Waits
    writes: Callable[[Any, Manager], Iterator[str]] = lambda *_: iter(())  # scopes (`cm.manager.access.leases`)
    behind_memory: Callable[[Any, Manager], bool] = lambda *_: False  # whether it waits for memories that are written
    counted: bool = False  # among the long ones of its client, of which there are so many at most
    uploads: bool = False  # its data may have been uploaded before


class Asked:
    """A request on its way: who asks, and the one answer."""

    __slots__ = ("_reply", "_size", "answered", "audit", "charged", "client", "connection", "held", "if_accepted",
                 "order", "request", "row", "sender")  # fmt: skip

    def __init__(
        self, row: Row, request: Any, connection: str, sender: bytes, client: Client, charged: Client, order: Order,
        reply: Callable[[Reply], object], size: int = -1,
    ) -> None:  # fmt: skip
        """`connection` and `client`: of who asks, a bridge's guest perhaps; `charged`: whose quota counts `size` bytes
        of it, if it is among the long ones.
        """
        self.row, self.request, self.connection, self.sender = row, request, connection, sender
        self.client, self.charged, self.order = client, charged, order
        self._reply, self._size = reply, size
        self.held: Holds | None = None
        self.if_accepted: Callable[[], object] | None = None
        self.audit: Callable[[Reply | None], object] | None = None  # of its begin if it takes time, and its end
        self.answered = False

    def hold(self, what: Holds) -> None:
        """Those behind it may have to wait for it, until it is answered."""
        self.held = what
        self.order.hold(self.sender, what)

    def answer(self, reply: Reply) -> None:
        """Reply; later answers are none. What waits for it goes on behind the reply."""
        if self.answered:
            return
        self.answered = True
        if self._size >= 0:
            self.charged.ended(self._size)
        if self.if_accepted is not None and reply.error is None:
            self.if_accepted()
        try:
            self._reply(reply)
        except Exception as error:  # noqa: BLE001 (every request gets an answer: this one cannot be encoded)
            self._reply(refusal(error))
        if self.audit is not None:
            self.audit(reply)
        if self.held is not None:
            self.order.release(self.sender, self.held)


@dataclass(slots=True)
class _Sender:
    """A sender's requests that are under way, and those that wait for them: without a request as long as it is read."""

    changes: list[Change] = field(default_factory=list)
    held: Counter[Holds] = field(default_factory=Counter)
    queue: deque[Asked] = field(default_factory=deque)


class Order:
    """What runs of each sender, and what waits for it."""

    def __init__(self, manager: Manager, carry_out: Callable[[Asked], None]) -> None:
        self._manager = manager
        self._carry_out = carry_out
        self.senders: dict[bytes, _Sender] = {}  # those with something under way

    def take(self, asked: Asked) -> None:
        """Carry out a request, now or in its turn."""
        state = self.senders.get(asked.sender)
        if state is None or asked.row.waits is Waits.NEVER or not (state.queue or self._is_blocked(state, asked)):
            self._carry_out(asked)
        elif len(state.queue) >= _MOST:
            asked.answer(refusal(Busy(f"{_MOST} requests wait for the end of a change; ask again after it")))
        else:
            state.queue.append(asked)

    def take_in_slices(self, asked: Asked, slices: Generator[None, None, WriteReg]) -> Iterator[None]:
        """Read a long request in these steps; what the sender asks for meanwhile waits behind it."""
        queue = self._state(asked.sender).queue
        queue.append(asked)
        return self._read(asked, slices, queue)

    def _read(self, asked: Asked, slices: Generator[None, None, WriteReg], queue: deque[Asked]) -> Iterator[None]:
        try:
            asked.request = yield from slices
        except InvalidRequest as error:
            queue.remove(asked)
            asked.answer(refusal(error))
        self._resume(asked.sender)

    def began(self, sender: bytes, change: Change) -> None:
        """A change waits for its turn or runs."""
        self._state(sender).changes.append(change)

    def ended(self, sender: bytes, change: Change) -> None:
        """It has ended, and was answered."""
        self.senders[sender].changes.remove(change)
        self._resume(sender)

    def hold(self, sender: bytes, what: Holds) -> None:
        """A request is under way that others may wait for."""
        self._state(sender).held[what] += 1

    def release(self, sender: bytes, what: Holds) -> None:
        """It is answered."""
        self.senders[sender].held[what] -= 1
        self._resume(sender)

    def _state(self, sender: bytes) -> _Sender:
        return self.senders.setdefault(sender, _Sender())

    def _is_blocked(self, state: _Sender, asked: Asked) -> bool:
        waits, held = asked.row.waits, state.held
        if held[Holds.LONG] or waits is Waits.TO_CHANGE:
            return any(held.values())
        if waits is not Waits.TO_WRITE:
            return False
        if held[Holds.WRITES] and asked.row.behind_memory(asked.request, self._manager):
            return True
        scopes = {"config", *asked.row.writes(asked.request, self._manager)}
        return any(scopes & set(change.scopes) for change in state.changes)

    def _resume(self, sender: bytes) -> None:
        """Carry out what waits no longer."""
        state = self.senders.get(sender)
        if state is None:
            return
        while state.queue and state.queue[0].request is not None and not self._is_blocked(state, state.queue[0]):
            self._carry_out(state.queue.popleft())
        if not (state.changes or state.queue or any(state.held.values())):
            self.senders.pop(sender, None)
