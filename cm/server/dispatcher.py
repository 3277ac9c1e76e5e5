# SPDX-License-Identifier: Apache-2.0
"""Incoming messages → requests, each in its turn, and their replies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import zmq
from zmq import zmq_poll

from cm.errors import Busy, InvalidRequest
from cm.server.client_quotas import LITTLE, PENDING, REPLY, TRACKED, Client, Ring, TooMuchWaiting
from cm.server.error_replies import refusal
from cm.server.publisher import Publisher
from cm.server.request_handlers import Services, carry_out
from cm.server.requests import BY_KIND
from cm.server.sender_order import Asked, Order
from cm.server.sockets import Loop, Sockets
from cm.wire import multipart
from cm.wire.decode import decode_request, split_text
from cm.wire.encode import encode_reply
from cm.wire.envelope import envelope_length, guest_named, split_envelope
from cm.wire.messages.requests import WriteReg
from cm.wire.messages.status import ErrorInfo, Reply
from cm.wire.multipart import Message, receive_from
from cm.wire.parse import LONG, writes
from cm.wire.request_table import Frame
from cm.wire.topics import WRITE_REG

_PUBLISHED = b""  # the sender of all messages on the SUB socket; a connection's name is never empty
_AHEAD = 32  # messages that are read in one turn, before one of them is served
_KEEPING = 1024  # bytes of overhead for each message that is read and waits for its turn


class Dispatcher:
    """Decodes what arrives at the two sockets for requests."""

    def __init__(
        self,
        loop: Loop,
        sockets: Sockets,
        services: Services,
        publisher: Publisher,
        note_error: Callable[[ErrorInfo], None],
    ) -> None:
        self._loop = loop
        self._sockets = sockets
        self._gate, self._clients, self._turns = services.connections.gate, services.clients, services.turns
        self._carry_out = partial(carry_out, services)
        self._order = Order(services.manager, self._carry_out)
        self._publisher = publisher
        self._note_error = note_error
        self._known, self._untold = self._clients.known, self._clients.untold
        self._coming: list[tuple[Any, int]] = [(sockets.req, int(zmq.POLLIN))]
        self._kept: Ring[tuple[Client, Message]] = Ring()  # of those that ask over several connections
        self._waits = False  # whether something is kept

    # ---- what comes ---------------------------------------------------------------------------

    def on_message(self) -> None:
        """Take a message off the SUB socket: as a request without a reply; errors show in the status."""
        came = receive_from(self._sockets.sub, routed=False)
        client = self._known.get(came.connection) or self._clients.of(came.connection)
        client.requests += 1
        reply = self._fire_and_forget
        self._dispatch(split_text(came.frames), _PUBLISHED, came.connection, client, client, reply)

    def on_request(self) -> None:
        """Take a message off the ROUTER, and answer one, now or when its work has ended.

        ROUTER hands out one message of each connection in turn, so users with one connection each are served in turn
        by that alone. Of a client that asks over several, messages are read ahead and wait here for its turn: otherwise
        200 connections would be 200 turns. So are those of a user with several clients, if there are other users.
        """
        if self._waits:  # it goes on by itself
            return
        came = receive_from(self._sockets.req, routed=True)
        client = self._known.get(came.connection) or self._clients.of(came.connection)
        client.requests += 1
        sender: bytes = came.frames[0]  # type: ignore[assignment]
        user, others = client.user, len(self._clients.users) > 1
        if client.sender == sender and (user.sender == sender or not others):
            (self._answer if client.unread_bytes <= LITTLE else self._serve)(came, client)
            return
        before = (client.sender, user.sender) if others else (client.sender,)
        client.sender = user.sender = sender
        if any(before):
            self._keep(client, came)
            self._serve_next()
        else:
            self._serve(came, client)

    def _serve_next(self) -> None:
        """Read what came meanwhile, and serve the client whose turn it is."""
        try:
            for _ in range(_AHEAD):
                if not zmq_poll(self._coming, 0):
                    break
                message = receive_from(self._sockets.req, routed=True)
                client = self._clients.of(message.connection)
                client.requests += 1
                client.sender = client.user.sender = message.frames[0]  # type: ignore[assignment]
                self._keep(client, message)
            if not self._kept:  # all were turned away
                return
            _, (client, came) = self._kept.take()
            client.waiting_bytes -= _size(came)
        finally:
            self._waits = bool(self._kept)
            if self._waits:
                self._loop.call_soon(self._serve_next)
        self._serve(came, client)

    def _keep(self, client: Client, came: Message) -> None:
        try:
            client.queue(_size(came))
        except TooMuchWaiting as error:
            self._turn_away(came, client, error)
        else:
            self._kept.add(client.turn, (client, came))

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

    def _answer(self, came: Message, charged: Client) -> None:
        frames, connection, client = came.frames, came.connection, charged
        if len(frames) == 4 and not frames[1]:
            cut = 2
        elif len(frames) == 5 and not frames[2] and bytes(frames[1]).isdigit():  # a number before it, as ours have
            cut = 3
        else:
            cut = envelope_length(frames)
            if guest := guest_named(frames[:cut]):  # a bridge may speak for one
                connection = self._gate.guest(connection, guest)
                client = self._clients.of(connection)
        message = frames[cut:]
        if len(message) == 1:
            message = split_text(message)
        topic = bytes(message[0]) if message else b""
        reply = partial(self._reply, frames[:cut], topic, charged)
        self._dispatch(message, bytes(frames[0]), connection, client, charged, reply)

    def _reply(self, envelope: list[Frame], topic: bytes, client: Client, reply: Reply) -> None:
        frames = [*envelope, *encode_reply(topic, reply, self._publisher.sequence)]
        sender: bytes = frames[0]  # type: ignore[assignment]
        # It may stay in ZeroMQ unread; the client's record knows how much does.
        untold = self._untold.get(sender, 0) + sum(map(len, frames)) + REPLY
        if untold < TRACKED:
            self._untold[sender] = untold
            multipart.send(self._sockets.req, frames)
        else:
            self._untold[sender] = 0
            client.sent(multipart.send_tracked(self._sockets.req, frames), untold, sender)

    def _fire_and_forget(self, reply: Reply) -> None:
        if reply.error is not None:
            self._note_error(reply.error)

    def _dispatch(
        self,
        frames: Sequence[Frame],
        sender: bytes,
        connection: str,
        client: Client,
        charged: Client,
        reply: Callable[[Reply], object],
    ) -> None:
        request: Any = None
        try:
            long = len(frames) == 2 and len(frames[1]) > LONG and frames[0] == WRITE_REG
            if long and self._turns.count(("reads", charged.account)) >= PENDING:
                raise TooMuchWaiting(f"{PENDING} long requests of {charged.account} wait: await a reply")
            request = None if long else decode_request(frames)
            row = BY_KIND[WriteReg if long else type(request)]
            size = sum(map(len, frames)) if row.counted else -1
            if row.counted:
                charged.begin(size)
        except (InvalidRequest, Busy) as error:
            charged.refused += 1
            reply(refusal(error))
            return
        asked = Asked(row, request, connection, sender, client, charged, self._order, reply, size)
        if long:
            slices = self._order.take_in_slices(asked, writes(bytes(frames[1])))
            self._turns.run(slices, (("reads", charged.account), charged.name))
        elif sender in self._order.senders:
            self._order.take(asked)
        else:  # mostly
            self._carry_out(asked)


def _size(message: Message) -> int:
    return sum(map(len, message.frames)) + _KEEPING
