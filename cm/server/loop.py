# SPDX-License-Identifier: Apache-2.0
"""The event loop, with ZeroMQ's sockets.

One socket, that of requests, is waited for by `zmq_poll`, which looks at its state before and after; all
else by the epoll, which `zmq_poll` waits for as well. That is half the cost per message of a `zmq.Poller`
with all of them (docs/performance.md).

A ZeroMQ socket's descriptor only says that something changed since the socket was last used in any way, sending
included (zmq_getsockopt(3), ZMQ_FD). So a socket behind the epoll is read until it has nothing more, and checked
again after anything was sent on it from elsewhere: by `Loop.send`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import zmq
from zmq import zmq_poll

from cm.loop import Callback, Timer
from cm.loop import Loop as EventLoop
from cm.wire import multipart

__all__ = ["Callback", "Loop", "Timer", "XpubSender"]

_LOG = logging.getLogger(__name__)
_POLLIN = int(zmq.POLLIN)  # arithmetic on the enumeration costs more than the call
_TURNS = 16  # requests that one socket may have served before others get their turn
# libzmq's thread empties a queue of short messages at once when it gets a processor: seconds to give it.
_PAUSES = (0.0001, 0.0005, 0.002, 0.01)
_HOPELESS = 1.0  # seconds for which a queue that stayed full is not waited for again
_NODROP, _NOBLOCK = int(zmq.XPUB_NODROP), int(zmq.NOBLOCK)


@dataclass(frozen=True, slots=True, eq=False)
class _Watched:
    """A ZeroMQ socket, and what takes one message off it."""

    sources: list[tuple[Any, int]]  # the socket, as `zmq_poll` takes it
    take: Callback


class Loop(EventLoop):
    """An event loop that a defect in a callback does not end: it is logged."""

    def __init__(self) -> None:
        super().__init__()
        self._sockets: dict[zmq.Socket[bytes], _Watched] = {}
        self._waited: list[tuple[Any, int]] = [(self._epoll.fileno(), _POLLIN)]  # as `zmq_poll` takes it
        self._takes: dict[Any, Callback] = {self._epoll.fileno(): partial(self._serve, 0)}  # of what is waited for
        self._unlooked: set[_Watched] = set()  # may have messages that their descriptors do not show

    def add_socket(self, socket: zmq.Socket[bytes], take: Callback, foremost: bool = False) -> None:
        """Call `take` when there are messages; it reads one or more from the socket.

        A `foremost` one costs less per message of its own, and a little with every other event.
        """
        if foremost:
            self._waited.append((socket, _POLLIN))
            self._takes[socket] = take
            return
        watched = self._sockets[socket] = _Watched([(socket, _POLLIN)], take)
        self.add(socket.fileno(), partial(self._look, watched))
        self._unlooked.add(watched)

    def send(self, socket: zmq.Socket[bytes], frames: Sequence[bytes | memoryview], flags: int = 0) -> None:
        """Send on a socket that is watched; the loop looks at it again before it waits."""
        watched = self._sockets.get(socket)
        if watched is not None:
            self._unlooked.add(watched)
        multipart.send(socket, frames, flags)

    def _wait(self, milliseconds: int) -> None:
        taken = self._look_again() if self._unlooked else False  # this may have set new timers
        for source, _ in zmq_poll(self._waited, 0 if taken or self._unlooked else milliseconds):
            try:
                self._takes[source]()
            except Exception as error:  # noqa: BLE001 (see _failed)
                self._failed(error)

    def _look(self, watched: _Watched) -> bool:
        """Serve a socket until it has nothing more, or for its share; returns whether it had something."""
        for turn in range(_TURNS):
            if not zmq_poll(watched.sources, 0):  # half the time of asking for ZMQ_EVENTS
                self._unlooked.discard(watched)
                return turn > 0
            self._guarded(watched.take)
        self._unlooked.add(watched)
        return True

    def _look_again(self) -> bool:
        taken = [self._look(watched) for watched in tuple(self._unlooked)]
        return any(taken)

    def _failed(self, error: Exception) -> None:
        _LOG.error("a callback failed", exc_info=error)


class XpubSender:
    """Sends what is published. The loop's thread.

    The socket has ZMQ_XPUB_NODROP: it reports when a subscriber's queue is full, and the message is then sent again
    without that option, so that all others get it.
    """

    def __init__(self, loop: Loop, socket: zmq.Socket[bytes]) -> None:
        self._loop = loop
        self._socket = socket
        self._hopeless_until = 0.0

    def send(self, message: Sequence[Any]) -> None:
        """Send a short message. Only a subscriber that has left its queue full for a while does not get it."""
        for pause in _PAUSES:
            try:
                self._loop.send(self._socket, message, _NOBLOCK)
                return
            except zmq.Again:
                if time.monotonic() < self._hopeless_until:
                    break
                time.sleep(pause)  # there is no event to wait for: a single subscriber's queue cannot be polled
        else:
            self._hopeless_until = time.monotonic() + _HOPELESS
        self._send_to_all(message)

    def send_frame(self, message: Sequence[Any]) -> bool:
        """Send a frame; False if a subscriber does not get it, because too much waits for it already."""
        try:
            self._loop.send(self._socket, message, _NOBLOCK)
        except zmq.Again:
            self._send_to_all(message)
            return False
        return True

    def _send_to_all(self, message: Sequence[Any]) -> None:
        """Send to all that have room; the others lose it."""
        self._socket.setsockopt(_NODROP, 0)
        try:
            self._loop.send(self._socket, message, _NOBLOCK)
        finally:
            self._socket.setsockopt(_NODROP, 1)
