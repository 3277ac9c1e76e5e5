# SPDX-License-Identifier: Apache-2.0
"""What the manager tells: status, registers, interrupts and frames on the XPUB socket."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import zmq

from cm._version import __version__
from cm.daemon.pump import Frame
from cm.messages.status import Irq, RegValues, Status
from cm.wire import encode, topics

_FRAME_TOPICS = (topics.READ_DATA, topics.DATA_READ)


class Publisher:
    """Keeps track of who subscribes to what; numbers statuses. The loop's thread."""

    def __init__(
        self,
        socket: zmq.Socket[bytes],
        send: Callable[[Sequence[bytes | memoryview]], None],
        status: Callable[[], Status],
        changed: Callable[[], None],
    ) -> None:
        self._socket = socket
        self._send = send
        self._status = status
        self._changed = changed  # subscriptions changed: streams may be wanted or not
        self._subscriptions: set[bytes] = set()
        self._numbers = itertools.count(1)
        self._started_ns = time.time_ns()
        self.sequence = 0

    def subscription(self) -> None:
        """Take subscription messages off the socket; a new subscriber to the status gets it at once."""
        wanted = False
        while True:
            try:
                message = self._socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                break
            topic = message[1:]
            if message[:1] == b"\x01":
                self._subscriptions.add(topic)
                wanted = wanted or topics.STATUS.startswith(topic)
            else:
                self._subscriptions.discard(topic)
        if wanted:
            self.status(self._status())
        self._changed()

    def has_subscriber(self, topic: bytes) -> bool:
        """Whether somebody subscribes to a topic."""
        return any(topic.startswith(prefix) for prefix in self._subscriptions)

    def wants_stream(self, name: str) -> bool:
        """Whether somebody listens to a stream's frames."""
        return any(map(self.has_subscriber, (*_FRAME_TOPICS, topics.STREAM_PREFIX + name.encode())))

    def complete(self, status: Status) -> Status:
        """A status with what only the daemon knows."""
        return replace(status, sequence=self.sequence, version=__version__, started_ns=self._started_ns)

    def status(self, status: Status) -> None:
        """Publish a status under a new number."""
        self.sequence = next(self._numbers)
        self._send(encode.encode_status(self.complete(status)))

    def registers(self, values: RegValues) -> None:
        """Publish changed registers."""
        self._send(encode.encode_registers(values))

    def interrupt(self, irq: Irq) -> None:
        """Publish an interrupt."""
        self._send(encode.encode_irq(irq))

    def frame(self, frame: Frame) -> None:
        """Publish a frame on every topic that somebody subscribes to; ZeroMQ copies it once for each."""
        info: bytes | None = None
        for topic in (*_FRAME_TOPICS, topics.STREAM_PREFIX + frame.info.stream.encode()):
            if self.has_subscriber(topic):
                info = info or encode.encode_frame_info(frame.info)
                self._send([topic, info, frame.data])
