# SPDX-License-Identifier: Apache-2.0
"""Blocking request and reply over a DEALER, with a time-out and notice of a manager that goes away."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import zmq
from zmq import zmq_poll
from zmq.utils.monitor import recv_monitor_message

from cm import multipart
from cm.client.address import Keys
from cm.client.errors import ConnectionLost, NoAnswer

Socket = zmq.Socket[bytes]


_POLLIN = int(zmq.POLLIN)  # an operation on pyzmq's enums costs as much as a system call
STREAM_HWM = 4  # frames that wait in a slow reader's socket before newer ones are lost

_AnySocket = TypeVar("_AnySocket", bound=zmq.Socket[Any])


def prepare(socket: _AnySocket, keys: Keys | None, depth: int = 0) -> _AnySocket:
    """Options that every client socket has, before it connects; `depth` messages wait (0: ZeroMQ's own number)."""
    if depth:
        socket.setsockopt(zmq.RCVHWM, depth)  # not to be set later: see cm/daemon/xpub.py
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.IPV6, 1)
    if keys is not None:
        socket.curve_serverkey = keys.server_public
        socket.curve_publickey = keys.public
        socket.curve_secretkey = keys.secret
    return socket


class Link:
    """One connection for requests; threads take turns."""

    def __init__(self, context: zmq.Context[Socket], address: str, keys: Keys | None) -> None:
        self._address = address
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._socket = prepare(context.socket(zmq.DEALER), keys)
        # A lost peer must be heard of at once on ipc, and within seconds over a dead network.
        self._socket.setsockopt(zmq.HEARTBEAT_IVL, 2000)
        self._socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 6000)
        self._monitor = self._socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        self._socket.connect(address)
        self._sources: list[tuple[Any, int]] = [(self._socket, _POLLIN), (self._monitor, _POLLIN)]

    def ask(
        self,
        frames: Sequence[Any],
        timeout: float | None,
        beside: Socket | None = None,
        on_beside: Callable[[], None] | None = None,
    ) -> list[bytes]:
        """Send a message and wait for its reply; meanwhile `on_beside` takes what comes on `beside`.

        Raises NoAnswer after `timeout` seconds (None: never), ConnectionLost if the manager goes away.
        """
        with self._lock:
            number = b"%d" % next(self._numbers)
            self._drain_monitor()
            multipart.send(self._socket, (number, b"", *frames))
            return self._wait(number, timeout, beside, on_beside)

    def _wait(
        self, number: bytes, timeout: float | None, beside: Socket | None, on_beside: Callable[[], None] | None
    ) -> list[bytes]:
        until = None if timeout is None else time.monotonic() + timeout
        sources = self._sources if beside is None else [*self._sources, (beside, _POLLIN)]
        while True:
            ready = dict(zmq_poll(sources, _milliseconds(until)))
            if beside in ready and on_beside is not None:
                on_beside()
            if self._socket in ready:
                frames = multipart.receive(self._socket)
                if frames[0] == number:  # others answer requests that timed out
                    return [bytes(frame) for frame in frames[2:]]
            elif self._monitor in ready:
                self._drain_monitor()
                raise ConnectionLost(f"the configuration manager at {self._address} went away")
            elif not ready and until is not None and time.monotonic() >= until:
                raise NoAnswer(f"no answer from a configuration manager at {self._address} within {timeout:g} s")

    def _drain_monitor(self) -> None:
        while zmq_poll(self._sources[1:], 0):
            recv_monitor_message(self._monitor)

    def close(self) -> None:
        """Disconnect; twice is fine."""
        if not self._socket.closed:
            self._socket.disable_monitor()
            self._monitor.close()
            self._socket.close()


def _milliseconds(until: float | None) -> int:
    return -1 if until is None else max(0, int((until - time.monotonic()) * 1000) + 1)
