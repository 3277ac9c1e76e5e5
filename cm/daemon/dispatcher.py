# SPDX-License-Identifier: Apache-2.0
"""Messages that come in → requests, and their replies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from cm import multipart
from cm.daemon.board_watch import BoardWatch
from cm.daemon.endpoints import Sockets
from cm.daemon.handlers import Handlers
from cm.daemon.loop import Loop
from cm.daemon.publisher import Publisher
from cm.daemon.read_cache import ReadCache
from cm.daemon.replies import Respond, refusal
from cm.errors import InvalidRequest
from cm.messages.requests import Request
from cm.messages.status import ErrorInfo, Reply
from cm.wire.decode import Frame, decode_request, split_text
from cm.wire.encode import encode_reply
from cm.wire.topics import READ_REG


class Dispatcher:
    """Decodes what arrives at the two sockets for requests."""

    def __init__(
        self,
        loop: Loop,
        sockets: Sockets,
        handlers: Handlers,
        read_cache: ReadCache,
        publisher: Publisher,
        board: BoardWatch,
        note_error: Callable[[ErrorInfo], None],
    ) -> None:
        self._loop = loop
        self._sockets = sockets
        self._handlers = handlers
        self._read_cache = read_cache
        self._publisher = publisher
        self._board = board
        self._note_error = note_error

    def on_request(self) -> None:
        """A message on the ROUTER: answer it, now or when its work has ended."""
        envelope, message = split_envelope(multipart.receive(self._sockets.req))
        if len(message) == 2 and message[0] == READ_REG and self._read_again(envelope, message[1]):
            return
        if len(message) == 1:
            message = split_text(message)
        topic = bytes(message[0]) if message else b""
        self._dispatch(message, partial(self._reply, envelope, topic))
        if topic == READ_REG:
            self._read_cache.learn(message)

    def _read_again(self, envelope: list[Frame], message: Frame) -> bool:
        """Answer a read of registers that was answered before; False where it was not."""
        try:
            reply = self._read_cache.answer(bytes(message), self._publisher.sequence)
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            self._board.noticed(error)
            self._reply(envelope, READ_REG, refusal(error))
            return True
        if reply is not None:
            self._loop.send(self._sockets.req, [*envelope, READ_REG, reply])
        return reply is not None

    def _reply(self, envelope: list[Frame], topic: bytes, reply: Reply) -> None:
        frames = encode_reply(topic, reply, self._publisher.sequence)
        self._loop.send(self._sockets.req, [*envelope, *frames])

    def on_message(self) -> None:
        """A message on the SUB: the same requests without a reply; what is wrong with them shows in the status."""
        self._dispatch(multipart.receive(self._sockets.sub), self._fire_and_forget)

    def _fire_and_forget(self, reply: Reply) -> None:
        if reply.error is not None:
            self._note_error(reply.error)

    def _dispatch(self, frames: Sequence[bytes | memoryview], respond: Respond) -> None:
        try:
            request: Request = decode_request(frames)
        except InvalidRequest as error:
            respond(refusal(error))
            return
        self._handlers.handle(request, respond)


def split_envelope(frames: list[Frame]) -> tuple[list[Frame], list[Frame]]:
    """What a ROUTER received → return path, message.

    A REQ socket puts an empty frame between them; a DEALER may, with frames of its own before it, or
    may send the message straight away.
    """
    if len(frames) > 1 and not frames[1]:  # most do
        return frames[:2], frames[2:]
    if len(frames) < 2 or bytes(frames[1][:3]) == b"cm_" or b"" not in frames[1:]:
        return frames[:1], frames[1:]
    cut = frames.index(b"", 1) + 1
    return frames[:cut], frames[cut:]
