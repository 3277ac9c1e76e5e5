# SPDX-License-Identifier: Apache-2.0
"""Incoming messages → requests, each in its turn, and their replies."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from cm.errors import Busy, CmError, InvalidRequest
from cm.manager.execution.worker import Change
from cm.manager.manager import Manager
from cm.server.board_watch import BoardWatch
from cm.server.endpoints import Sockets
from cm.server.handlers import Handlers
from cm.server.intake import Rest
from cm.server.publisher import Publisher
from cm.server.read_cache import ReadCache
from cm.server.register_handlers import takes_long
from cm.server.replies import Respond, refusal
from cm.server.rights.model import Role
from cm.server.shares.budget import Budget
from cm.server.touched import Touched
from cm.wire import multipart
from cm.wire.decode import Frame, decode_request, split_text
from cm.wire.encode import encode_reply
from cm.wire.envelope import envelope_length, guest_named, split_envelope
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ErrorInfo, Reply
from cm.wire.multipart import Message
from cm.wire.parse import LONG, in_slices
from cm.wire.topics import READ_REG, WRITE_REG

_PUBLISHED = b""  # the sender of all messages on the SUB socket; a connection's name is never empty
_MOST = 256  # requests of one sender that wait
_LOOKS = (rq.ReadStatus, rq.ReadConfig, rq.ListConfigs, rq.PlanChange, rq.ReadIrq, rq.CancelChange)  # never wait
_STORES = (rq.Provision, rq.RemoveConfig)
_LASTING = frozenset({rq.ChangeMode, rq.PlanChange, *_STORES, rq.ReadData, rq.WriteData})  # not done at once
_WRITES = (rq.WriteReg, rq.WriteData, rq.ConfigureStream, rq.DefineMemory)
_Waiting = tuple[rq.Request, Respond, str]  # and the client's connection, as in `cm.server.rights`


@dataclass(slots=True)
class _Sender:
    """A sender's requests that are under way, and those that wait for them."""

    changes: list[Change] = field(default_factory=list)
    stores: int = 0  # configurations that are being stored
    writes: int = 0  # memories that are being written
    long: int = 0  # registers, piece by piece
    queue: deque[_Waiting] = field(default_factory=deque)

    @property
    def idle(self) -> bool:
        return not (self.changes or self.stores or self.writes or self.long or self.queue)


class Order:
    """Requests of one sender take effect in the order in which they were sent. The loop's thread.

    A change of mode, a configuration that is stored and a memory that is written take time, and the manager goes on
    serving meanwhile. A later write from the same sender waits if one of them would overwrite or refuse it, and what
    comes after that write waits too. No sender waits for another's requests. A sender is a connection to the ROUTER;
    all clients of the SUB socket are one sender together.
    """

    def __init__(self, handlers: Handlers, manager: Manager) -> None:
        self._handlers = handlers
        self._manager = manager
        self._touched = Touched(manager)
        self.senders: dict[bytes, _Sender] = {}  # those with something under way

    def waits(self, sender: bytes) -> bool:
        """Whether something of that sender waits, so that further requests have to wait as well."""
        found = self.senders.get(sender)
        return found is not None and bool(found.queue)

    def take(self, sender: bytes, request: rq.Request, respond: Respond, connection: str) -> None:
        """Carry out a request, now or in its turn."""
        state = self.senders.get(sender) if self.senders else None
        if state is None or isinstance(request, _LOOKS) or not (state.queue or self._is_blocked(state, request)):
            self._do(sender, request, respond, connection)
        elif len(state.queue) >= _MOST:
            respond(refusal(Busy(f"{_MOST} requests wait for the end of a change; ask again after it")))
        else:
            state.queue.append((request, respond, connection))

    def _is_blocked(self, state: _Sender, request: rq.Request) -> bool:
        if state.long or isinstance(request, (rq.ChangeMode, *_STORES)):
            return bool(state.long or state.stores or state.writes)
        if state.writes and (isinstance(request, rq.WriteReg) or self._touched.writes_memory(request)):
            return True
        return isinstance(request, _WRITES) and any(self._touched.touches(change, request) for change in state.changes)

    def _do(self, sender: bytes, request: rq.Request, respond: Respond, connection: str) -> None:
        if isinstance(request, (rq.ReadReg, rq.WriteReg)):
            if takes_long(request, self._manager.registers):
                respond = self._counted(sender, "long", respond)
        elif isinstance(request, _STORES):
            respond = self._counted(sender, "stores", respond)
        elif isinstance(request, rq.WriteData) and self._touched.writes_memory(request):
            respond = self._counted(sender, "writes", respond)
        self._handlers.handle(connection, request, respond, partial(self._began, sender))

    def _counted(self, sender: bytes, kind: str, respond: Respond) -> Respond:
        """Count a request as under way until it is answered."""
        state = self.senders.setdefault(sender, _Sender())
        setattr(state, kind, getattr(state, kind) + 1)

        def answered(reply: Reply) -> None:
            setattr(state, kind, getattr(state, kind) - 1)
            respond(reply)
            self._go_on(sender)

        return answered

    def _began(self, sender: bytes, change: Change) -> Callable[[], None]:
        """A change waits for its turn or runs; the result is to be called when it has ended."""
        state = self.senders.setdefault(sender, _Sender())
        state.changes.append(change)

        def ended() -> None:
            state.changes.remove(change)
            self._go_on(sender)

        return ended

    def _go_on(self, sender: bytes) -> None:
        state = self.senders.get(sender)
        if state is None:
            return
        while state.queue and not self._is_blocked(state, state.queue[0][0]):
            self._do(sender, *state.queue.popleft())
        if state.idle:
            self.senders.pop(sender, None)


class Dispatcher:
    """Decodes what arrives at the two sockets for requests."""

    def __init__(
        self,
        sockets: Sockets,
        handlers: Handlers,
        manager: Manager,
        read_cache: ReadCache,
        publisher: Publisher,
        board: BoardWatch,
        note_error: Callable[[ErrorInfo], None],
    ) -> None:
        self._sockets = sockets
        self._gate, intake = handlers.gate, handlers.intake
        self._order = Order(handlers, manager)
        self._read_cache = read_cache
        self._publisher = publisher
        self._board = board
        self._note_error = note_error
        self.taken = 0
        self.refused = Counter[str]()  # by the error's code
        # For messages on the ROUTER, which are answered now or when their work has ended.
        self.on_request = intake.add(sockets.req, self._answer, self._turn_away, lambda came: bytes(came.frames[0]))
        # For messages on the SUB socket: as above without a reply; errors show in the status.
        self.on_message = intake.add(sockets.sub, self._obey, self._ignore, lambda came: came.connection)

    def _turn_away(self, came: Message, budget: Budget, error: Busy) -> None:
        """Refuse a request, because too much of its client's waits."""
        envelope, message = split_envelope(came.frames)
        topic = bytes(split_text(message)[0]) if message else b""
        self._reply(envelope, topic, budget, refusal(error))

    def _ignore(self, _: Message, __: Budget, error: Busy) -> None:
        self._fire_and_forget(refusal(error))

    def _answer(self, came: Message, budget: Budget) -> Rest:
        self.taken += 1
        frames = came.frames
        cut = 2 if len(frames) == 4 and not frames[1] else envelope_length(frames)
        if cut > 2 and (guest := guest_named(frames[:cut])):  # a bridge may speak for one
            came = came._replace(connection=self._gate.guest(came.connection, guest))
        if len(frames) == cut + 2 and frames[cut] == READ_REG and self._read_again(came, budget):
            return None
        envelope, message = frames[:cut], split_text(frames[cut:])
        topic = bytes(message[0]) if message else b""
        rest = self._dispatch(bytes(frames[0]), came, message, partial(self._reply, envelope, topic, budget), budget)
        if topic == READ_REG:
            self._read_cache.learn(message)
        return rest

    def _read_again(self, came: Message, budget: Budget) -> bool:
        """Answer a read of registers that was answered before; False where it was not."""
        frames, order, gate, who = came.frames, self._order, self._gate, came.connection
        allowed = who in gate.observers or gate.everywhere(who) >= Role.OBSERVE  # to read what others read
        if not allowed or (order.senders and order.waits(bytes(frames[0]))):
            return False
        try:
            reply = self._read_cache.answer(bytes(frames[-1]), self._publisher.sequence)
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            self._board.noticed(error)
            self._reply(frames[:-2], READ_REG, budget, refusal(error))
            return True
        if reply is not None:
            frames[-1] = reply
            self._send(frames, budget)
        return reply is not None

    def _reply(self, envelope: list[Frame], topic: bytes, budget: Budget, reply: Reply) -> None:
        if reply.error is not None:
            self.refused[reply.error.code] += 1
        self._send([*envelope, *encode_reply(topic, reply, self._publisher.sequence)], budget)

    def _send(self, frames: list[Frame], budget: Budget) -> None:
        """Send a reply. It may stay in ZeroMQ unread; the client's budget knows how much does."""
        told = budget.replied(frames[0], sum(map(len, frames)))
        if told:
            budget.sent(multipart.send_tracked(self._sockets.req, frames), told, frames[0])
        else:
            multipart.send(self._sockets.req, frames)

    def _obey(self, came: Message, budget: Budget) -> Rest:
        self.taken += 1
        return self._dispatch(_PUBLISHED, came, split_text(came.frames), self._fire_and_forget, budget)

    def _fire_and_forget(self, reply: Reply) -> None:
        if reply.error is not None:
            self.refused[reply.error.code] += 1
            self._note_error(reply.error)

    def _dispatch(self, sender: bytes, came: Message, frames: Sequence[Frame], respond: Respond, by: Budget) -> Rest:
        if len(frames) == 2 and len(frames[1]) > LONG and frames[0] == WRITE_REG:  # in slices
            take = partial(self._order.take, sender, respond=respond, connection=came.connection)
            return in_slices(frames, take, partial(_refuse, respond, by))
        try:
            request: rq.Request = decode_request(frames)
            if type(request) in _LASTING:
                respond = by.under_way(respond, came.large)
        except (InvalidRequest, Busy) as error:
            _refuse(respond, by, error)
        else:
            self._order.take(sender, request, respond, came.connection)
        return None


def _refuse(respond: Respond, by: Budget, error: CmError) -> None:
    by.refused += 1
    respond(refusal(error))
