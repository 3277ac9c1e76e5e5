# SPDX-License-Identifier: Apache-2.0
"""The streams that run: opened and closed as `policy` decides, with their clients. Runs in the loop's thread."""

from __future__ import annotations

import errno
import logging
import os
import select
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from typing import Protocol

from cm.device import AxiDma, DeviceTimeout
from cm.device.data_plane import ClientGone, ClientLeaves, Plane
from cm.errors import CmError
from cm.schema.model import Direction, Stream
from cm.server.devices import BoardDevices
from cm.server.loop import Loop
from cm.server.steps import Steps
from cm.server.streams.clients import LocalClients, ZmqClients
from cm.server.streams.memory import Allocations, Echoes, MemoryThread
from cm.server.streams.peer import Peer
from cm.server.streams.policy import StreamEvent, StreamPolicy, Users
from cm.server.streams.stream import Frame, Moved, OpenStream, StreamTotals
from cm.wire.messages.status import ErrorInfo


class StalledChannels:
    """Remembers channels by their stream's name until they answer. Used in the loop's thread."""

    def __init__(self, probe: Callable[[str], int]) -> None:
        """`probe` makes a descriptor that polls readable when a channel answers."""
        self._probe = probe
        self._channels: dict[str, AxiDma] = {}  # open; an answer is overdue
        self._probes: dict[str, int] = {}  # could not be opened

    def begin(self, name: str, channel: AxiDma) -> None:
        """Take over an open channel that did not answer."""
        self._channels[name] = channel

    def probe(self, stream: Stream) -> None:
        """Watch a channel that could not be opened because nothing answered. Raises OSError if it cannot be watched."""
        self._probes[stream.name] = self._probe(stream.channel)

    def answered(self) -> list[str]:
        """Release the channels that answer again and can be reopened, and return their names. Does not block."""
        back = [name for name, channel in self._channels.items() if channel.answers]
        for name in back:
            self._channels.pop(name).close()
        ready = _readable(self._probes.values())
        probed = [name for name, descriptor in self._probes.items() if descriptor in ready]
        for name in probed:
            os.close(self._probes.pop(name))
        return [*back, *probed]

    def close(self) -> None:
        """Close all channels and probes."""
        for channel in self._channels.values():
            channel.close()
        for descriptor in self._probes.values():
            os.close(descriptor)
        self._channels.clear()
        self._probes.clear()


def _readable(descriptors: Iterable[int]) -> set[int]:
    poll = select.poll()
    for descriptor in descriptors:
        poll.register(descriptor, select.POLLIN)
    return {descriptor for descriptor, _ in poll.poll(0)}


class Subscribers(Protocol):
    """Those who subscribe to frames over ZeroMQ."""

    def wants_stream(self, name: str) -> bool:
        """Whether a stream has subscribers."""

    def overruns(self, stream: str) -> int:
        """How often a subscriber began to lose a stream's frames."""

    def frame(self, frame: Frame) -> None:
        """Send a frame to its subscribers; its memory is valid only during the call."""


_LOG = logging.getLogger(__name__)
_EVENTS = 32  # of the plane that are taken in one turn of the loop


class RunningStreams:
    """The open streams, their clients, and the plane that moves the frames."""

    def __init__(
        self,
        loop: Loop,
        devices: BoardDevices,
        subscribers: Subscribers,
        policy: StreamPolicy,
        on_error: Callable[[ErrorInfo], None],
        slots_each: int,
        steps: Steps,
    ) -> None:
        self._slots_each = slots_each
        self._loop = loop
        self._devices = devices
        self._subscribers = subscribers
        self._policy = policy
        self._on_error = on_error
        self.plane = Plane()
        self._thread = MemoryThread(loop)
        self.echoes = Echoes(self.plane, self._thread)
        self.allocations = Allocations(self.plane, self._thread, devices.port_memory, devices.memory)
        self.open: dict[str, OpenStream] = {}
        self._totals = StreamTotals()
        self.failures: dict[str, ErrorInfo] = {}  # by stream of this mode: why it last failed
        self.locals = LocalClients(self.plane, on_error)
        self.zmq = ZmqClients(loop, self.plane, subscribers.frame, self._take)
        self._steps = steps
        self._stalled = StalledChannels(devices.probe_dma)
        loop.add(self.plane.fileno(), self._plane_event)

    def renew(self, slots_each: int) -> None:
        """Set how many slots of a stream one process may hold."""
        self._slots_each = slots_each
        for opened in self.open.values():
            opened.holders.each = slots_each

    def refresh(self) -> None:
        """Open streams that are wanted, and close those that are no longer wanted."""
        for name in self._stalled.answered() if self._policy.stalled() else ():
            self._policy.after(name, StreamEvent.ANSWER)
        for event, stream in self._policy.due(self.users):
            if event is StreamEvent.OPEN:
                self._start_quietly(stream)
            else:
                self.stop(stream.name)
        for opened in list(self.open.values()):
            self.zmq.refresh(opened, self.has_subscriber(opened.stream))

    def users(self, stream: Stream) -> Users:
        """Return who uses a stream now."""
        return Users(self.has_subscriber(stream), self.locals.use(stream.name), self.zmq.busy(stream.name))

    def has_subscriber(self, stream: Stream) -> bool:
        """Whether the stream is an input with at least one subscriber."""
        return stream.direction is Direction.S2MM and self._subscribers.wants_stream(stream.name)

    def settle(self) -> None:
        """Process the disconnections that have already happened, so that those clients no longer count as users."""
        self.plane.settle()
        self._plane_event(sys.maxsize)  # each client has two at most

    def running(self, stream: Stream, first: Callable[[OpenStream], object] = lambda _: None) -> OpenStream:
        """Return a stream, opened if need be; it starts in a later turn. Raises StreamStopped, Timeout, DeviceError."""
        self._policy.check_may_run(stream.name)
        return self.open.get(stream.name) or self._start(stream, first)

    def attach(
        self, stream: Stream, client: int, depth: int, peer: Peer, stopped: Callable[[int], object]
    ) -> Iterator[None]:
        """Return the steps by which a client joins; if the stream may not run now, it waits, and `stopped` is called.

        The steps raise NoSlots or DeviceError; a stream that cannot start is then closed.
        """
        opened = self.open.get(stream.name)
        if opened is not None:
            return self._watched(opened, opened.holders.join(client, depth, peer, stopped))
        if not self._policy.may_run(stream.name):
            stopped(0)
            return iter(())
        steps: list[Iterator[None]] = []
        opened = self._start(stream, lambda o: steps.append(o.holders.join(client, depth, peer, stopped)), paid=True)
        return self._watched(opened, steps[0])

    def _watched(
        self, opened: OpenStream, steps: Iterator[None], failed: Callable[[CmError | OSError], object] | None = None
    ) -> Iterator[None]:
        """Take the steps; pass an error to `failed`, or raise it, and close the stream if it has not started."""
        try:
            yield from steps
        except (CmError, OSError) as error:
            if failed is not None:
                failed(error)
            self._not_started(opened, error)
            if failed is None:
                raise

    def _take(self, opened: OpenStream, steps: Iterator[None], failed: Callable[[CmError | OSError], object]) -> None:
        """Take the steps as `_watched` does, in turns of the loop of their own."""
        self._steps.run(self._watched(opened, steps, failed))

    def _not_started(self, opened: OpenStream, error: CmError | OSError) -> None:
        """Close a stream that could not get its first slots; a running one goes on without its new client."""
        name, late = opened.stream.name, isinstance(error, DeviceTimeout)
        if not opened.holders.started and self.open.get(name) is opened:
            opened.holders.fail(error)
            self.zmq.close(name, error)
            (self._stall if late else self.stop)(name, errno.ETIMEDOUT if late else 0)

    def stop(self, name: str, error: int = 0) -> None:
        """Close a stream if it is open, and tell its clients `error` (an errno, or 0)."""
        opened = self.open.pop(name, None)
        if opened is None:
            return
        self._policy.after(name, StreamEvent.CLOSE)
        self._totals.add(name, opened.moved())
        if (failure := opened.failure()) is not None:
            self.failures[name] = failure
        try:
            opened.close(error)
        finally:
            self.zmq.close(name)

    def moved(self) -> dict[str, Moved]:
        """What each stream has moved since the manager started, however often it was reopened."""
        return self._totals.with_ended({name: opened.moved() for name, opened in self.open.items()})

    def _failed(self, name: str, error: ErrorInfo) -> None:
        self.failures[name] = error
        self._on_error(error)

    def close(self) -> None:
        """Disconnect all clients and end the plane's thread."""
        for held in (self._stalled, self.allocations, self._thread):
            held.close()
        self._loop.remove(self.plane.fileno())
        self.plane.close()

    def _start(
        self, stream: Stream, first: Callable[[OpenStream], object] = lambda _: None, paid: bool = False
    ) -> OpenStream:
        """Open a stream with the client that `first` attaches; `paid`: that client's steps start the stream."""
        opened = self._opened(stream)
        try:
            config, mode = self._policy.config, self._policy.mode
            opened.label(config.name if config else "", mode or "")
            waiting = self.locals.attach_all(opened)
            first(opened)
            self.zmq.refresh(opened, self.has_subscriber(stream))
            for client, steps in waiting:
                self._steps.run(self._watched(opened, steps, partial(self.locals.refused, opened, client)))
            if not paid:
                self._take(opened, opened.holders.begin(), partial(self._unopened, stream.name))
        except BaseException:
            self.stop(stream.name)
            raise
        return opened

    def _opened(self, stream: Stream) -> OpenStream:
        try:
            opened = OpenStream(self.plane, self._devices.dma(stream.channel), stream, self._slots_each)
        except DeviceTimeout:
            with suppress(OSError):  # if it cannot be watched, the next client to open it finds out again
                self._stalled.probe(stream)
                self._policy.after(stream.name, StreamEvent.STALL)
            raise
        self.open[stream.name] = opened
        self._policy.after(stream.name, StreamEvent.OPEN)
        return opened

    def _start_quietly(self, stream: Stream) -> None:
        try:
            self._start(stream)
        except (CmError, OSError) as error:
            self._unopened(stream.name, error)

    def _unopened(self, name: str, error: CmError | OSError) -> None:
        code = error.code if isinstance(error, CmError) else "device_error"
        self._failed(name, ErrorInfo(code, f"stream {name!r} cannot be opened: {error}"))

    def _stall(self, name: str, error: int) -> None:
        """Close a stream whose channel does not answer; the channel is kept, and watched until it answers again."""
        opened = self.open.pop(name)
        self._totals.add(name, opened.moved())
        self._policy.after(name, StreamEvent.STALL)
        self._stalled.begin(name, opened.release(error))
        self.zmq.close(name)

    def _plane_event(self, most: int = _EVENTS) -> None:
        """Take some of the plane's events; it stays readable while there are more."""
        for taken in range(most):
            event = self.plane.event()
            if event is None:
                if not taken:
                    return
                break
            if isinstance(event, ClientGone):
                self._client_gone(event.client)
            elif isinstance(event, ClientLeaves):
                self.locals.leaves(event.client)
            else:
                self._lost(event.stream, event.error)
        self.refresh()

    def _client_gone(self, client: int) -> None:
        self.echoes.gone(client)
        self.allocations.gone(client)
        opened = self.open.get(self.locals.gone(client) or "")
        if opened is not None:
            opened.holders.detached(client)

    def _lost(self, number: int, error: int) -> None:
        for name in [name for name, opened in self.open.items() if opened.id == number]:
            text = os.strerror(error)
            _LOG.warning("stream %s ended: %s", name, text)
            if error == errno.ETIMEDOUT:
                self._stall(name, error)
            else:
                self.stop(name, error)
            self._failed(name, ErrorInfo("device_error", f"stream {name!r} ended: {text}"))
