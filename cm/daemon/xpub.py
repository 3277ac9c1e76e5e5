# SPDX-License-Identifier: Apache-2.0
"""The way out of an XPUB socket: how much may wait for a slow subscriber, and who is told of losses.

ZeroMQ's high-water mark counts messages, of any length, for each subscriber. `mark()` makes one of a limit
in bytes (`cm serve --stream-queue`) and the longest frame that the schemas know. It is set before the socket
is bound and never again: while a subscriber is going, setting it makes libzmq, up to and with 4.3.5, use a
pipe that it has freed (mended by its pull request 4647, which is in no release yet).
The socket has ZMQ_XPUB_NODROP: it says when a queue is full, which it does not otherwise, and the message
is sent again without, so that all others get it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from typing import Any

import zmq

from cm.daemon.loop import Loop
from cm.schema.model import ITEM_BYTES, Config, Stream

BYTES = 32 << 20  # of frames that wait for one subscriber, unless set otherwise
_FEWEST, _MOST = 2, 1000  # messages
_FLAT = 1 << 20  # bytes of a frame that no schema describes, or that may grow

# libzmq's thread takes short messages off a queue in no time, once it has a processor: seconds to give it.
_PAUSES = (0.0001, 0.0005, 0.002, 0.01)
_HOPELESS = 1.0  # seconds for which a queue that stayed full is not waited for again

_NODROP, _NOBLOCK = int(zmq.XPUB_NODROP), int(zmq.NOBLOCK)


def mark(configs: Iterable[Config], limit: int) -> int:
    """How many messages may wait for one subscriber: the longest frames of `configs` stay within `limit` bytes."""
    longest = max((_frame_bytes(stream) for config in configs for stream in _streams(config)), default=0)
    return max(_FEWEST, min(_MOST, limit // max(longest, _FLAT)))


def _streams(config: Config) -> Iterable[Stream]:
    yield from config.streams.values()
    for mode in config.modes.values():
        yield from mode.streams.values()


def _frame_bytes(stream: Stream) -> int:
    return math.prod(stream.shape) * ITEM_BYTES.get(stream.dtype, 16) if stream.shape else 0


class XpubSender:
    """Sends what is published. The loop's thread."""

    def __init__(self, loop: Loop, socket: zmq.Socket[bytes]) -> None:
        self._loop = loop
        self._socket = socket
        self._hopeless_until = 0.0

    def send(self, message: Sequence[Any]) -> None:
        """Send a short message. Only who has left its queue full for a while does not get it."""
        for pause in _PAUSES:
            try:
                self._loop.send(self._socket, message, _NOBLOCK)
                return
            except zmq.Again:
                if time.monotonic() < self._hopeless_until:
                    break
                time.sleep(pause)  # there is no event to wait for: one subscriber's queue is none to poll
        else:
            self._hopeless_until = time.monotonic() + _HOPELESS
        self._send_to_all(message)

    def send_frame(self, message: Sequence[Any]) -> bool:
        """Send a frame; False if a subscriber does not get it, because as much as may wait for it already does."""
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
