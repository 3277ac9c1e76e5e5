# SPDX-License-Identifier: Apache-2.0
"""What the manager tells: status, registers, interrupts and frames on the XPUB socket.

The socket has ZMQ_XPUB_NODROP: it says when a subscriber's queue is full, which it does not otherwise, and the
message is sent again without, so that all others get it.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

import zmq
from zmq import zmq_poll

from cm._version import __version__
from cm.daemon.loop import Loop
from cm.daemon.streams.compression import Compressor, compressions
from cm.daemon.streams.stream import Frame
from cm.messages.status import FrameInfo, Irq, LeaseStatus, RegValues, SensorStatus, Status, StreamStatus
from cm.native import guard
from cm.wire import encode, topics

# libzmq's thread takes short messages off a queue in no time, once it has a processor: seconds to give it.
_PAUSES = (0.0001, 0.0005, 0.002, 0.01)
_HOPELESS = 1.0  # seconds for which a queue that stayed full is not waited for again

_NODROP, _NOBLOCK = int(zmq.XPUB_NODROP), int(zmq.NOBLOCK)
_AT_ONCE = 32  # subscriptions that are taken before others get their turn
TOPICS_EACH, TOPICS_ALL = 64 << 10, 1 << 20  # bytes of the topics of one connection, and of all
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


class Wires(Protocol):
    """What is known of connections by their descriptors (`cm.native.guard`)."""

    def serial(self, fd: int, /) -> int:
        """A number that no other connection has; 0: it is none."""

    def cut(self, fd: int, /) -> None:
        """End it; OSError where it is none."""


class Subscriptions:
    """Topics with a subscriber; each counts for the connection that named it first.

    A connection that names too many is ended, and where all together are too many, the one that named most of them:
    libzmq keeps a node for each byte, for as long as the connection lasts. Memory is given back as they go.
    """

    def __init__(self, wires: Wires) -> None:
        self._wires = wires
        self._owners: dict[bytes, tuple[int, int]] = {}  # serial and descriptor
        self._bytes: Counter[tuple[int, int]] = Counter()
        self._peak = 0  # topics that there were, since the table was last made anew

    def add(self, topic: bytes, source: int) -> None:
        """A subscription over a connection."""
        if topic in self._owners:
            return
        owner = self._owners[topic] = self._wires.serial(source), source
        self._bytes[owner] += len(topic) + 1
        self._peak = max(self._peak, len(self._owners))
        if self._bytes[owner] > TOPICS_EACH:
            self._end(owner)
        elif self._bytes.total() > TOPICS_ALL:
            self._end(max(self._bytes, key=self._bytes.__getitem__))

    def _end(self, owner: tuple[int, int]) -> None:
        """Its topics go as soon as libzmq tells of them."""
        if self._wires.serial(owner[1]) == owner[0]:
            with suppress(OSError):
                self._wires.cut(owner[1])

    def discard(self, topic: bytes) -> None:
        """The last subscription to it is gone."""
        owner = self._owners.pop(topic, None)
        if owner is None:
            return
        self._bytes[owner] -= len(topic) + 1
        if not self._bytes[owner]:
            del self._bytes[owner]
        if len(self._owners) < self._peak // 8:  # a dict does not shrink by itself
            self._owners, self._peak = dict(self._owners), len(self._owners)

    def covers(self, topic: bytes, least: int = 0) -> bool:
        """Whether one of `least` bytes or more is a prefix of a topic; as long as that, however many there are."""
        owners = self._owners
        return bool(owners) and any(topic[:length] in owners for length in range(least, len(topic) + 1))


class Publisher:
    """Keeps track of who subscribes to what; numbers statuses. The loop's thread."""

    def __init__(self, loop: Loop, socket: zmq.Socket[bytes], board: str = "", wires: Wires = guard) -> None:
        self._socket = socket
        self._coming: list[tuple[Any, int]] = [(socket, int(zmq.POLLIN))]  # subscriptions that were not taken yet
        self._board = board or os.uname().nodename
        self._sender = XpubSender(loop, socket)
        self._compressor = Compressor(loop, self._compressed)
        self._subscriptions = Subscriptions(wires)
        self._overruns: Counter[str] = Counter()
        self._started_ns = time.time_ns()
        self._sensors: tuple[SensorStatus, ...] = ()
        self.sequence = 0

    def take_subscriptions(self) -> bool:
        """Take some subscription messages off the socket; whether one wants the status, which it gets at once."""
        wanted = False
        for _ in range(_AT_ONCE):
            try:
                frame = self._socket.recv(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                break
            message = frame.bytes
            topic = message[1:]
            if message[:1] == b"\x01":
                self._subscriptions.add(topic, frame.get(zmq.SRCFD))
                wanted = wanted or topics.STATUS.startswith(topic)
            else:
                self._subscriptions.discard(topic)
        return wanted

    def has_subscriber(self, topic: bytes) -> bool:
        """Whether a topic has a subscriber."""
        return self._subscriptions.covers(topic)

    def wants_stream(self, name: str) -> bool:
        """Whether a stream's frames have a subscriber."""
        return self._wants_compressed(name) or any(map(self.has_subscriber, _topics(name)))

    def _wants_compressed(self, name: str) -> bool:
        """Only who names the topic: a subscription to everything does not mean every form of it."""
        return self._subscriptions.covers(topics.LZ4_PREFIX + name.encode(), len(topics.LZ4_PREFIX))

    def overruns(self, stream: str) -> int:
        """How often a subscriber began to lose a stream's frames."""
        return self._overruns[stream]

    def measured(self, sensors: tuple[SensorStatus, ...]) -> None:
        """What the board's sensors say now; told with the statuses from here on. Any thread."""
        self._sensors = sensors

    def complete(self, status: Status, streams: tuple[StreamStatus, ...], leases: tuple[LeaseStatus, ...]) -> Status:
        """A status with what only the daemon knows."""
        return replace(
            status,
            streams=streams,
            leases=leases,
            sequence=self.sequence,
            version=__version__,
            started_ns=self._started_ns,
            board=self._board,
            realtime_offset_ns=time.time_ns() - time.monotonic_ns(),
            sensors=self._sensors,
        )

    def status(self, make: Callable[[], Status]) -> bool:
        """Publish a status under a new number; False if none is made, as no one subscribes to it.

        A change tells a dozen, each of which takes longer to make and encode than the step that it tells of.
        Who subscribes gets one at once, so nothing is missed; the number counts all the same.
        """
        self.sequence += 1
        if not self.has_subscriber(topics.STATUS):
            return False
        self._sender.send(encode.encode_status(make()))
        return True

    def registers(self, values: RegValues) -> None:
        """Publish changed registers, where anyone subscribes to them, or may: unlike a status, they are told once."""
        if self.has_subscriber(topics.READ_REG) or zmq_poll(self._coming, 0):
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
