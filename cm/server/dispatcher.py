# SPDX-License-Identifier: Apache-2.0
"""Incoming messages → requests, each in its turn, and their replies."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import zmq
from zmq import zmq_poll

from cm.errors import Busy, CmError, InvalidRequest
from cm.frozen import dataclass, field
from cm.manager.access.leases import scopes_written
from cm.manager.execution.worker import Change
from cm.manager.manager import Manager
from cm.schema.model import Memory
from cm.server.board_watch import BoardWatch
from cm.server.client_quotas import LITTLE, PENDING, REPLY, TRACKED, Client, Ring, TooMuchWaiting
from cm.server.error_replies import Respond, refusal
from cm.server.publisher import Publisher
from cm.server.read_cache import ReadCache
from cm.server.request_handlers import Handlers, takes_long
from cm.server.rights.model import Role
from cm.server.sockets import Loop, Sockets
from cm.wire import multipart
from cm.wire.decode import decode_request, split_text
from cm.wire.encode import encode_reply
from cm.wire.envelope import envelope_length, guest_named, split_envelope
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ErrorInfo, Reply
from cm.wire.multipart import Message, receive_from
from cm.wire.parse import LONG, in_slices
from cm.wire.request_table import Frame
from cm.wire.topics import READ_REG, WRITE_REG


class Conflicts:
    """What requests touch in the mode that is loaded now."""

    def __init__(self, manager: Manager) -> None:
        self._manager = manager

    def touches(self, change: Change, request: rq.Request) -> bool:
        """Whether a change writes what this request writes, or loads its region."""
        config, mode = self._manager.loaded_config(), self._manager.state.mode
        memory = self._memory(request.stream) if isinstance(request, (rq.WriteData, rq.ConfigureStream)) else None
        return bool({"config", *scopes_written(request, config, mode, memory)} & set(change.scopes))

    def writes_memory(self, request: rq.Request) -> bool:
        """Whether it writes to a memory, and not to a stream."""
        return isinstance(request, rq.WriteData) and self._memory(request.stream) is not None

    def _memory(self, name: str) -> Memory | None:
        try:
            return self._manager.memories.find(name)
        except CmError:  # a name of another mode, or nothing is loaded: its handler says so
            return None


_PUBLISHED = b""  # the sender of all messages on the SUB socket; a connection's name is never empty
_MOST = 256  # requests of one sender that wait
_LOOKS = (rq.ReadStatus, rq.ReadConfig, rq.ListConfigs, rq.PlanChange, rq.ReadIrq, rq.CancelChange)  # never wait
_STORES = (rq.Provision, rq.RemoveConfig)
_LASTING = frozenset({rq.ChangeMode, rq.PlanChange, *_STORES, rq.ReadData, rq.WriteData})  # not done at once
_WRITES = (rq.WriteReg, rq.WriteData, rq.ConfigureStream, rq.DefineMemory)
_AHEAD = 32  # messages that are read in one turn, before one of them is served
_KEEPING = 1024  # bytes of overhead for each message that is read and waits for its turn


@dataclass(slots=True)
class _Waiting:
    """A request that waits; None as long as it is still being read, in slices."""

    request: rq.Request | None
    respond: Respond
    connection: str  # of the client, as in `cm.server.rights`


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
        self._conflicts = Conflicts(manager)
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
            state.queue.append(_Waiting(request, respond, connection))

    def take_long(self, sender: bytes, frames: Sequence[Frame], respond: Respond, connection: str) -> Iterator[None]:
        """Read a long request in these steps; what the sender asks for meanwhile waits behind it."""
        state = self.senders.setdefault(sender, _Sender())
        waiting = _Waiting(None, respond, connection)
        state.queue.append(waiting)

        def read(request: rq.Request) -> None:
            waiting.request = request
            self._go_on(sender)

        def refuse(error: CmError) -> None:
            state.queue.remove(waiting)
            respond(refusal(error))
            self._go_on(sender)

        return in_slices(frames, read, refuse)

    def _is_blocked(self, state: _Sender, request: rq.Request) -> bool:
        if state.long or isinstance(request, (rq.ChangeMode, *_STORES)):
            return bool(state.long or state.stores or state.writes)
        if state.writes and (isinstance(request, rq.WriteReg) or self._conflicts.writes_memory(request)):
            return True
        return isinstance(request, _WRITES) and any(
            self._conflicts.touches(change, request) for change in state.changes
        )

    def _do(self, sender: bytes, request: rq.Request, respond: Respond, connection: str) -> None:
        if isinstance(request, (rq.ReadReg, rq.WriteReg)):
            if takes_long(request, self._manager.registers):
                respond = self._counted(sender, "long", respond)
        elif isinstance(request, _STORES):
            respond = self._counted(sender, "stores", respond)
        elif isinstance(request, rq.WriteData) and self._conflicts.writes_memory(request):
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
        while state.queue:
            waiting = state.queue[0]
            if waiting.request is None or self._is_blocked(state, waiting.request):
                break
            state.queue.popleft()
            self._do(sender, waiting.request, waiting.respond, waiting.connection)
        if state.idle:
            self.senders.pop(sender, None)


class Dispatcher:
    """Decodes what arrives at the two sockets for requests."""

    def __init__(
        self,
        loop: Loop,
        sockets: Sockets,
        handlers: Handlers,
        manager: Manager,
        read_cache: ReadCache,
        publisher: Publisher,
        board: BoardWatch,
        note_error: Callable[[ErrorInfo], None],
    ) -> None:
        self._loop = loop
        self._sockets = sockets
        self._gate, self._clients, self._steps = handlers.gate, handlers.clients, handlers.steps
        self._order = Order(handlers, manager)
        self._read_cache = read_cache
        self._publisher = publisher
        self._board = board
        self._note_error = note_error
        self.taken = 0
        self.refused = Counter[str]()  # by the error's code
        self._known, self._untold = self._clients.known, self._clients.untold
        self._coming: list[tuple[Any, int]] = [(sockets.req, int(zmq.POLLIN))]
        self._kept: Ring[Client, Message] = Ring()  # of clients that ask over several connections
        self._waits = False  # whether something is kept

    # ---- what comes ---------------------------------------------------------------------------

    def on_message(self) -> None:
        """Take a message off the SUB socket: as a request without a reply; errors show in the status."""
        came = receive_from(self._sockets.sub, routed=False)
        client = self._known.get(came.connection) or self._clients.of(came.connection)
        client.requests += 1
        self.taken += 1
        self._dispatch(_PUBLISHED, came, split_text(came.frames), self._fire_and_forget, client)

    def on_request(self) -> None:
        """Take a message off the ROUTER, and answer one, now or when its work has ended.

        ROUTER hands out one message of each connection in turn, so clients with one connection each are served in turn
        by that alone. Of a client that asks over several, messages are read ahead and wait here for the client's turn:
        otherwise 200 connections would be 200 turns.
        """
        if self._waits:  # it goes on by itself
            return
        came = receive_from(self._sockets.req, routed=True)
        client = self._known.get(came.connection) or self._clients.of(came.connection)
        client.requests += 1
        sender: bytes = came.frames[0]  # type: ignore[assignment]
        if client.sender == sender:
            if client.unread_bytes <= LITTLE:
                self._answer(came, client)
            else:
                self._serve(came, client)
            return
        several, client.sender = client.sender != b"", sender
        if several:
            self._keep(client, came)
            self._go_on()
        else:
            self._serve(came, client)

    def _go_on(self) -> None:
        """Read what came meanwhile, and serve the client whose turn it is."""
        try:
            for _ in range(_AHEAD):
                if not zmq_poll(self._coming, 0):
                    break
                message = receive_from(self._sockets.req, routed=True)
                client = self._clients.of(message.connection)
                client.requests += 1
                client.sender = message.frames[0]  # type: ignore[assignment]
                self._keep(client, message)
            if not self._kept:  # all were turned away
                return
            client, came = self._kept.take()
            client.waiting_bytes -= _size(came)
        finally:
            self._waits = bool(self._kept)
            if self._waits:
                self._loop.call_soon(self._go_on)
        self._serve(came, client)

    def _keep(self, client: Client, came: Message) -> None:
        try:
            client.queue(_size(came))
        except TooMuchWaiting as error:
            self._turn_away(came, client, error)
        else:
            self._kept.add(client, came)

    def _serve(self, came: Message, client: Client) -> None:
        if client.unread_bytes > LITTLE and not client.reads(came.frames[0]):  # type: ignore[arg-type]
            if client.reads_nothing:
                client.refused += 1  # and not even told
            else:
                self._turn_away(came, client, client.unread())
            return
        self._answer(came, client)

    def _turn_away(self, came: Message, client: Client, error: Busy) -> None:
        """Refuse a request, because too much of its client's waits."""
        client.refused += 1
        envelope, message = split_envelope(came.frames)
        topic = bytes(split_text(message)[0]) if message else b""
        self._reply(envelope, topic, client, refusal(error))

    def _answer(self, came: Message, client: Client) -> None:
        self.taken += 1
        frames = came.frames
        if len(frames) == 4 and not frames[1]:
            cut = 2
        elif len(frames) == 5 and not frames[2] and bytes(frames[1]).isdigit():  # a number before it, as ours have
            cut = 3
        else:
            cut = envelope_length(frames)
            if guest := guest_named(frames[:cut]):  # a bridge may speak for one
                came = came._replace(connection=self._gate.guest(came.connection, guest))
        if len(frames) == cut + 2 and frames[cut] == READ_REG and self._read_again(came, client):
            return
        envelope, message = frames[:cut], split_text(frames[cut:])
        topic = bytes(message[0]) if message else b""
        self._dispatch(bytes(frames[0]), came, message, partial(self._reply, envelope, topic, client), client)
        if topic == READ_REG:
            self._read_cache.learn(message)

    def _read_again(self, came: Message, client: Client) -> bool:
        """Answer a read of registers that was answered before; False where it was not."""
        frames, order, gate, who = came.frames, self._order, self._gate, came.connection
        allowed = who in gate.observers or gate.everywhere(who) >= Role.OBSERVE  # to read what others read
        if not allowed or (order.senders and order.waits(bytes(frames[0]))):
            return False
        try:
            reply = self._read_cache.answer(bytes(frames[-1]), self._publisher.sequence)
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            self._board.noticed(error)
            self._reply(frames[:-2], READ_REG, client, refusal(error))
            return True
        if reply is not None:
            frames[-1] = reply
            self._send(frames, client)
        return reply is not None

    def _reply(self, envelope: list[Frame], topic: bytes, client: Client, reply: Reply) -> None:
        if reply.error is not None:
            self.refused[reply.error.code] += 1
        self._send([*envelope, *encode_reply(topic, reply, self._publisher.sequence)], client)

    def _send(self, frames: list[Frame], client: Client) -> None:
        """Send a reply. It may stay in ZeroMQ unread; the client's record knows how much does."""
        sender: bytes = frames[0]  # type: ignore[assignment]
        untold = self._untold.get(sender, 0) + sum(map(len, frames)) + REPLY
        if untold < TRACKED:
            self._untold[sender] = untold
            multipart.send(self._sockets.req, frames)
        else:
            self._untold[sender] = 0
            client.sent(multipart.send_tracked(self._sockets.req, frames), untold, sender)

    def _fire_and_forget(self, reply: Reply) -> None:
        if reply.error is not None:
            self.refused[reply.error.code] += 1
            self._note_error(reply.error)

    def _dispatch(
        self, sender: bytes, came: Message, frames: Sequence[Frame], respond: Respond, client: Client
    ) -> None:
        if len(frames) == 2 and len(frames[1]) > LONG and frames[0] == WRITE_REG:
            reads = "reads", client
            if self._steps.count(reads) < PENDING:
                self._steps.run(self._order.take_long(sender, frames, respond, came.connection), reads)
            else:
                client.refused += 1
                respond(refusal(TooMuchWaiting(f"{PENDING} long requests of {client.name} wait: await a reply")))
            return
        try:
            request: rq.Request = decode_request(frames)
            if type(request) in _LASTING:
                respond = client.under_way(respond, sum(map(len, frames)))
        except (InvalidRequest, Busy) as error:
            client.refused += 1
            respond(refusal(error))
        else:
            self._order.take(sender, request, respond, came.connection)


def _size(message: Message) -> int:
    return sum(map(len, message.frames)) + _KEEPING
