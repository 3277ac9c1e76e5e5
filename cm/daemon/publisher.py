# SPDX-License-Identifier: Apache-2.0
"""What the manager tells: status, registers, interrupts and frames on the XPUB socket."""

from __future__ import annotations

import itertools
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import zmq

from cm._version import __version__
from cm.daemon.loop import Loop
from cm.daemon.streams.compression import Compressor, compressions
from cm.daemon.streams.stream import Frame
from cm.daemon.xpub import XpubSender
from cm.messages.status import FrameInfo, Irq, RegValues, Status
from cm.wire import encode, topics

_FRAME_TOPICS = (topics.READ_DATA, topics.DATA_READ)


class Publisher:
    """Keeps track of who subscribes to what; numbers statuses. The loop's thread."""

    def __init__(self, loop: Loop, socket: zmq.Socket[bytes], board: str = "") -> None:
        self._socket = socket
        self._board = board or os.uname().nodename
        self._sender = XpubSender(loop, socket)
        self._compressor = Compressor(loop, self._compressed)
        self._subscriptions: set[bytes] = set()
        self._overruns: Counter[str] = Counter()
        self._numbers = itertools.count(1)
        self._started_ns = time.time_ns()
        self.sequence = 0

    def take_subscriptions(self) -> bool:
        """Take subscription messages off the socket; whether one of them wants the status, which it gets at once."""
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
        return wanted

    def has_subscriber(self, topic: bytes) -> bool:
        """Whether a topic has a subscriber."""
        return any(topic.startswith(prefix) for prefix in self._subscriptions)

    def wants_stream(self, name: str) -> bool:
        """Whether a stream's frames have a subscriber."""
        return self._wants_compressed(name) or any(map(self.has_subscriber, _topics(name)))

    def _wants_compressed(self, name: str) -> bool:
        """Only who names the topic: a subscription to everything does not mean every form of it."""
        topic = topics.LZ4_PREFIX + name.encode()
        return any(s.startswith(topics.LZ4_PREFIX) and topic.startswith(s) for s in self._subscriptions)

    def overruns(self, stream: str) -> int:
        """How often a subscriber began to lose a stream's frames."""
        return self._overruns[stream]

    def complete(self, status: Status) -> Status:
        """A status with what only the daemon knows."""
        return replace(
            status,
            sequence=self.sequence,
            version=__version__,
            started_ns=self._started_ns,
            board=self._board,
            realtime_offset_ns=time.time_ns() - time.monotonic_ns(),
        )

    def status(self, status: Status) -> None:
        """Publish a status under a new number."""
        self.sequence = next(self._numbers)
        self._sender.send(encode.encode_status(self.complete(status)))

    def registers(self, values: RegValues) -> None:
        """Publish changed registers."""
        self._sender.send(encode.encode_registers(values))

    def interrupt(self, irq: Irq) -> None:
        """Publish an interrupt."""
        self._sender.send(encode.encode_irq(irq))

    def frame(self, frame: Frame) -> None:
        """Publish a frame on every topic that has a subscriber; ZeroMQ copies it once for each."""
        name, message = frame.info.stream, None
        for topic in _topics(name):
            if self.has_subscriber(topic):
                message = message or encode.encode_frame_info(frame.info)
                self._send_frame(name, [topic, message, frame.data])
        if self._wants_compressed(name) and compressions() and not self._compressor.offer(frame):
            self._overruns[name] += 1

    def _compressed(self, info: FrameInfo, data: bytes) -> None:
        if self._wants_compressed(info.stream):
            topic = topics.LZ4_PREFIX + info.stream.encode()
            self._send_frame(info.stream, [topic, encode.encode_frame_info(info), data])

    def _send_frame(self, stream: str, message: Sequence[Any]) -> None:
        if not self._sender.send_frame(message):
            self._overruns[stream] += 1

    def close(self) -> None:
        """End the thread that compresses."""
        self._compressor.close()


def _topics(stream: str) -> tuple[bytes, ...]:
    return *_FRAME_TOPICS, topics.STREAM_PREFIX + stream.encode()
