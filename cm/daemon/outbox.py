# SPDX-License-Identifier: Apache-2.0
"""The way out of an XPUB socket: how much may wait for a slow subscriber, in bytes.

ZeroMQ's high-water mark counts messages, of any length, for each subscriber. Here it is what fits into a
limit in bytes (`cm serve --stream-queue`) of the longest frames that are being published; short messages go
beyond it, up to `HWM_PUB`.
The socket has ZMQ_XPUB_NODROP: it says when a queue is full, which it does not otherwise, and the message
is sent again without, so that all others get it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import zmq

from cm.daemon.loop import Loop
from cm.daemon.sockets import HWM_PUB

BYTES = 32 << 20  # of frames that wait for one subscriber, where nobody says
_FEWEST = 2  # frames, however long they are

_SNDHWM, _NODROP, _NOBLOCK = int(zmq.SNDHWM), int(zmq.XPUB_NODROP), int(zmq.NOBLOCK)


class Outbox:
    """Sends what is published. The loop's thread."""

    def __init__(self, loop: Loop, socket: zmq.Socket[bytes], limit: int = BYTES) -> None:
        self._loop = loop
        self._socket = socket
        self._limit = limit
        self._lengths: dict[str, int] = {}  # of the frames of each stream
        self._mark = HWM_PUB

    def keep(self, wanted: Callable[[str], bool]) -> None:
        """Forget streams that nobody listens to any more: they no longer limit the others."""
        gone = [name for name in self._lengths if not wanted(name)]
        for name in gone:
            del self._lengths[name]
        if gone:
            self._set_mark()

    def _set_mark(self) -> None:
        longest = max(self._lengths.values(), default=0) or 1
        mark = max(_FEWEST, min(HWM_PUB, self._limit // longest))
        if mark != self._mark:
            self._mark = mark
            self._apply_mark()

    def _apply_mark(self) -> None:
        self._socket.setsockopt(_SNDHWM, self._mark)  # libzmq: to the connections that are there, to no other

    def joined(self) -> None:
        """A subscriber came: its connection has the mark that the socket had when it was bound."""
        self._apply_mark()

    def send(self, message: Sequence[Any]) -> None:
        """Send a short message: who is behind with frames still gets it."""
        try:
            self._loop.send(self._socket, message, _NOBLOCK)
            return
        except zmq.Again:
            self._socket.setsockopt(_SNDHWM, HWM_PUB)
        try:
            self._send_to_all(message)
        finally:
            self._apply_mark()

    def send_frame(self, stream: str, message: Sequence[Any]) -> bool:
        """Send a frame; False if a subscriber does not get it, because as much as may wait for it already does."""
        length = len(message[-1])
        if length > self._lengths.get(stream, 0):
            self._lengths[stream] = length
            self._set_mark()
        try:
            self._loop.send(self._socket, message, _NOBLOCK)
        except zmq.Again:
            self._send_to_all(message)
            return False
        return True

    def _send_to_all(self, message: Sequence[Any]) -> None:
        """To all that have room; the others lose it."""
        self._socket.setsockopt(_NODROP, 0)
        try:
            self._loop.send(self._socket, message, _NOBLOCK)
        finally:
            self._socket.setsockopt(_NODROP, 1)
