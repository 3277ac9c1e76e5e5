# SPDX-License-Identifier: Apache-2.0
"""What the manager tells: status, registers, interrupts and frames on the XPUB socket.

The socket has ZMQ_XPUB_NODROP: it says when a subscriber's queue is full, which it does not otherwise, and the
message is sent again without, so that all others get it.
"""

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
from cm.messages.status import FrameInfo, Irq, RegValues, SensorStatus, Status
from cm.wire import encode, topics

# libzmq's thread takes short messages off a queue in no time, once it has a processor: seconds to give it.
_PAUSES = (0.0001, 0.0005, 0.002, 0.01)
_HOPELESS = 1.0  # seconds for which a queue that stayed full is not waited for again

_NODROP, _NOBLOCK = int(zmq.XPUB_NODROP), int(zmq.NOBLOCK)
_FRAME_TOPICS = (topics.READ_DATA, topics.DATA_READ)


class XpubSender:
    """Sends what is published. The loop's thread."""

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
        self._sensors: tuple[SensorStatus, ...] = ()
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

    def measured(self, sensors: tuple[SensorStatus, ...]) -> None:
        """What the board's sensors say now; told with the statuses from here on. Any thread."""
        self._sensors = sensors

    def complete(self, status: Status) -> Status:
        """A status with what only the daemon knows."""
        return replace(
            status,
            sequence=self.sequence,
            version=__version__,
            started_ns=self._started_ns,
            board=self._board,
            realtime_offset_ns=time.time_ns() - time.monotonic_ns(),
            sensors=self._sensors,
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
