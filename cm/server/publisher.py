# SPDX-License-Identifier: Apache-2.0
"""What the manager publishes on the XPUB socket (status, registers, interrupts, frames), and how much may wait.

ZeroMQ's high-water mark counts messages, of any length, for each subscriber. `mark()` makes one of a limit
in bytes (`streams.queue_mib`) and the longest frame that the schemas know. It is set before the socket is bound and
never again: setting it while a subscriber disconnects makes libzmq up to 4.3.5 use a pipe that it has freed
(fixed by its pull request 4647, which is in no release yet).
"""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import zmq
from zmq import zmq_poll

from cm._version import __version__
from cm.manager.manager import Manager
from cm.manager.status_reports import Moment
from cm.schema.model import ITEM_BYTES, Config
from cm.server.interrupts import InterruptWatch
from cm.server.settings.model import StreamSettings
from cm.server.sockets import Loop
from cm.server.streams.running import Streams
from cm.server.streams.stream import Frame
from cm.wire import encode, topics
from cm.wire.messages.status import ErrorInfo, Irq, RegValues, SensorStatus, Status
from cm.wire.multipart import connection_of

BYTES = int(StreamSettings().queue_mib * (1 << 20))  # of frames that wait for one subscriber, unless set otherwise
_FEWEST, _MOST = 2, 1000  # messages
_ON_THEIR_WAY = 4  # messages that libzmq holds beside those that it counts
# libzmq's thread empties a queue of short messages at once when it gets a processor: seconds to give it.
_PAUSES = (0.0001, 0.0005, 0.002, 0.01)
_HOPELESS = 1.0  # seconds for which a queue that stayed full is not waited for again
_NODROP, _NOBLOCK = int(zmq.XPUB_NODROP), int(zmq.NOBLOCK)
_FLAT = 1 << 20  # bytes of a frame that no schema describes, or that may grow
_TOGETHER = 0.02  # seconds in which the steps of a change are collected: telling each wakes more than the step does

_LOG = logging.getLogger("cm")
_AT_ONCE = 32  # subscriptions that are read before others get their turn
TOPICS_EACH = 64 << 10  # bytes of the topics of one connection
AT_A_TIME = 1024  # subscriptions of a connection between two calls of `settle`
_Owner = tuple[int, str]  # descriptor and id of a connection
End = Callable[[int, str], None]  # ends the connection that they name
_FRAME_TOPICS = (topics.READ_DATA, topics.DATA_READ)


def mark(configs: Iterable[Config], limit: int) -> int:
    """How many messages may wait for one subscriber: the longest frames of `configs` stay within `limit` bytes."""
    longest = _FLAT
    for config in configs:
        for streams in (config.streams, *(mode.streams for mode in config.modes.values())):
            sizes = [math.prod(s.shape) * ITEM_BYTES.get(s.dtype, 16) for s in streams.values() if s.shape]
            longest = max([longest, *sizes])
    return max(_FEWEST, min(_MOST, limit // longest))


class UnreadFrames:
    """Frames that some subscriber has not received yet, with a bound on all together.

    Each subscriber may leave different ones unread. If all exceed one and a half times what one may leave unread
    (`limit` bytes, `mark` messages), the subscriber that has not read for longest is disconnected.
    """

    def __init__(self, limit: int, mark: int, end_slowest: Callable[[], object]) -> None:
        self._limit, self._mark = limit * 3 // 2, mark * 3 // 2 + _ON_THEIR_WAY
        self._end_slowest = end_slowest
        self._frames: deque[tuple[zmq.MessageTracker, int]] = deque()
        self.bytes = 0  # as of the last look

    def add(self, tracker: zmq.MessageTracker, size: int) -> None:
        """Note a frame that was sent to its subscribers."""
        self._frames.append((tracker, size))
        self.bytes += size
        most = max(self._limit, self._mark * size)
        if self._frames[0][0].done or self.bytes > most:
            self._frames = deque([(tracker, size) for tracker, size in self._frames if not tracker.done])
            self.bytes = sum([size for _, size in self._frames])
        if self.bytes > most:
            self._end_slowest()


class Subscriptions:
    """Topics with a subscriber; each counts for the connection that named it first.

    A connection that names too many is ended: libzmq keeps a node for each byte as long as the connection lasts. One
    that subscribes without end, if only to the same topic, is ended too: libzmq takes in more of that than can be read
    here, and the manager serves nobody else.
    """

    def __init__(self, end: End) -> None:
        self._end = end
        self._owners: dict[bytes, _Owner] = {}
        self._bytes: Counter[_Owner] = Counter()
        self._came: Counter[_Owner] = Counter()  # since the last `settle`

    def add(self, topic: bytes, source: int, name: str) -> None:
        """Add a subscription of a connection, which has this descriptor and id."""
        owner = source, name
        self._came[owner] += 1
        if self._came[owner] == AT_A_TIME + 1:
            self._end(*owner)
        if topic in self._owners:
            return
        self._owners[topic] = owner
        self._bytes[owner] += len(topic) + 1
        if self._bytes[owner] > TOPICS_EACH:
            self._end(*owner)

    def discard(self, topic: bytes) -> None:
        """The last subscription to it is gone."""
        owner = self._owners.pop(topic, None)
        if owner is None:
            return
        self._bytes[owner] -= len(topic) + 1
        if not self._bytes[owner]:
            del self._bytes[owner]

    def settle(self) -> None:
        """A second is over: as many may come again."""
        self._came.clear()

    def covers(self, topic: bytes, least: int = 0) -> bool:
        """Whether one of `least` bytes or more is a prefix of a topic; its time depends on the topic's length only."""
        owners = self._owners
        if topic in owners or not owners:
            return bool(owners)
        return any(topic[:length] in owners for length in range(least, len(topic)))


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


class Publisher:
    """Keeps track of subscriptions; numbers statuses. The loop's thread."""

    def __init__(
        self,
        loop: Loop,
        socket: zmq.Socket[bytes],
        board: str = "",
        end: End = lambda _, __: None,
        end_stuck: Callable[[], None] = lambda: None,
        limit: int = BYTES,
    ) -> None:
        """`limit`: bytes of frames that may wait for one subscriber; `end_stuck` ends the one that reads nothing."""
        self._socket = socket
        self._coming: list[tuple[Any, int]] = [(socket, int(zmq.POLLIN))]  # subscriptions that were not taken yet
        self._board = board or os.uname().nodename
        self._sender = XpubSender(loop, socket)
        self._subscriptions = Subscriptions(end)
        self._overruns: Counter[str] = Counter()
        self._unread = UnreadFrames(limit, socket.sndhwm, end_stuck)
        self._started_ns = time.time_ns()
        self._counting = threading.Lock()
        self._last_logged = ""
        self._sensors: tuple[SensorStatus, ...] = ()
        self.sequence = 0
        self.wants_audit = False  # whether someone subscribes to that topic: a request has no time to ask

    def take_subscriptions(self) -> bool:
        """Read some subscription messages; returns whether one wants the status, which it gets at once."""
        wanted = False
        for _ in range(_AT_ONCE):
            try:
                frame = self._socket.recv(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                break
            message = frame.bytes
            topic = message[1:]
            if message[:1] == b"\x01":
                self._subscriptions.add(topic, frame.get(zmq.SRCFD), connection_of(frame))
                wanted = wanted or topics.STATUS.startswith(topic)
            else:
                self._subscriptions.discard(topic)
        self.wants_audit = self._subscriptions.covers(topics.AUDIT, len(topics.AUDIT))
        return wanted

    def settle(self) -> None:
        """Once a second."""
        self._subscriptions.settle()

    def has_subscriber(self, topic: bytes) -> bool:
        """Whether a topic has a subscriber."""
        return self._subscriptions.covers(topic)

    def wants_stream(self, name: str) -> bool:
        """Whether a stream's frames have a subscriber."""
        return any(map(self.has_subscriber, _topics(name)))

    def overruns(self, stream: str) -> int:
        """How often a subscriber began to lose a stream's frames."""
        return self._overruns[stream]

    def measured(self, sensors: tuple[SensorStatus, ...]) -> None:
        """What the board's sensors say now; part of the statuses from here on. Any thread."""
        self._sensors = sensors

    def beside(self) -> dict[str, Any]:
        """What only the daemon knows of a status, except streams and leases."""
        return {
            "sequence": self.sequence,
            "version": __version__,
            "started_ns": self._started_ns,
            "board": self._board,
            "realtime_offset_ns": time.time_ns() - time.monotonic_ns(),
            "sensors": self._sensors,
        }

    def status(self, make: Callable[[], Status]) -> bool:
        """Publish a status under a new number; False if none is made, as no one subscribes to it.

        A change publishes a dozen, each of which takes longer to make and encode than the step that it reports. A new
        subscriber gets one at once, so nothing is missed; the number still counts on.
        """
        if self.passes_over():
            return False
        self._count()
        self._sender.send(encode.encode_status(make()))
        return True

    def passes_over(self) -> bool:
        """Count a status that no one subscribes to; False if someone does. Any thread."""
        if self._subscriptions.covers(topics.STATUS):
            return False
        self._count()
        return True

    def _count(self) -> None:
        with self._counting:
            self.sequence += 1

    def log(self, error: ErrorInfo | None, change: int) -> None:
        """Log the error of a status once, however often it is published; `change`: the last one's number."""
        text = f"{error.code}: {error.message}" if error else ""
        if error and text != self._last_logged:
            _LOG.warning("%s%s", text, f" (change {change})" if change else "")
        self._last_logged = text

    def registers(self, values: RegValues) -> None:
        """Publish changed registers, if anyone subscribes to them or may: unlike a status, they are sent only once."""
        if self._subscriptions.covers(topics.READ_REG) or zmq_poll(self._coming, 0):
            self._sender.send(encode.encode_registers(values))

    def interrupt(self, irq: Irq) -> None:
        """Publish an interrupt."""
        self._sender.send(encode.encode_irq(irq))

    def audit(self, message: Sequence[Any]) -> None:
        """Publish who changed what."""
        self._sender.send(message)

    def frame(self, frame: Frame) -> None:
        """Publish a frame on every topic that has a subscriber; it is copied once."""
        name = frame.info.stream
        wanted = [topic for topic in _topics(name) if self.has_subscriber(topic)]
        if not wanted:
            return
        message, body = encode.encoded(frame.info), zmq.Frame(bytes(frame.data), track=True, copy=False)
        for topic in wanted:
            if not self._sender.send_frame([topic, message, body]):
                self._overruns[name] += 1
        self._unread.add(body.tracker, len(frame.data))


class StatusPublisher:
    """What clients are told of the manager: implements `cm.manager.interfaces.Observer`.

    `begin` comes before all else, as the manager is made with this. All but the observer's calls: the loop's thread.
    """

    def __init__(self, loop: Loop, publisher: Publisher, streams: Streams) -> None:
        self._loop = loop
        self._publisher = publisher
        self._streams = streams
        self._manager: Manager
        self._interrupts: InterruptWatch
        self.registers_changed = publisher.registers  # those are written in the loop's thread only
        self._moments: deque[Moment] = deque()
        self._collecting = False  # what is put there waits, for a moment
        self.at_rest: Callable[[], None] = lambda: None  # something is different, and no change runs

    def begin(self, manager: Manager, interrupts: InterruptWatch) -> None:
        """Tell of this manager; its interrupts are watched anew when another configuration is loaded."""
        self._manager, self._interrupts = manager, interrupts

    def status(self, moment: Moment | None = None) -> Status:
        """The status of a moment, or of now."""
        manager, streams = self._manager, self._streams.status()
        beside = {"leases": manager.leases.statuses(), "windows": manager.mapped, **self._publisher.beside()}
        return manager.reporter.status(moment, streams=streams, **beside)

    def publish(self) -> None:
        """Publish the status of now, after those of before."""
        self._publish_moments()
        self._publisher.status(self.status)

    def take_subscriptions(self) -> None:
        """Someone subscribes, or does no longer."""
        if self._publisher.take_subscriptions():
            self.publish()
        self._streams.refresh()

    # ---- observer: any thread ---------------------------------------------------------

    def status_changed(self) -> None:
        """Every status is published, in order, even if the next follows at once."""
        self._moments.append(self._manager.reporter.moment())
        self._loop.call_threadsafe(self._publish_moments)

    def progressed(self) -> None:
        """Most statuses of a change say only this: if no one subscribes, they are counted but not made.

        The first is published at once; those that follow closely are, together.
        """
        if self._publisher.passes_over():
            return
        self._moments.append(self._manager.reporter.moment())
        if not self._collecting:
            self._collecting = True
            self._loop.call_threadsafe(self._publish_moments)
            self._loop.call_threadsafe(lambda: self._loop.call_later(_TOGETHER, self._publish_collected))

    def _publish_collected(self) -> None:
        self._collecting = False  # before looking: whoever saw it set has put its moment there
        self._publish_moments()

    def _publish_moments(self) -> None:
        while self._moments:
            moment = self._moments.popleft()
            if not moment.running:
                config = self._manager.loaded_config()
                if self._interrupts.incomplete or config is not self._interrupts.config:
                    self._interrupts.watch(config)
                self.at_rest()
            if self._publisher.status(partial(self.status, moment)):
                self._manager.reporter.was_read()
            self._publisher.log(moment.error, moment.last[0])


def _topics(stream: str) -> tuple[bytes, ...]:
    return *_FRAME_TOPICS, topics.STREAM_PREFIX + stream.encode()
