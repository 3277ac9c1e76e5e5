# SPDX-License-Identifier: Apache-2.0
"""Opens and closes streams as `policy` decides, and reports the results back to it. The loop's thread."""

from __future__ import annotations

import errno
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

from cm.daemon.host.devices import BoardDevices
from cm.daemon.loop import Loop
from cm.daemon.streams.allocations import Allocations
from cm.daemon.streams.audience import Audience
from cm.daemon.streams.beside import Beside
from cm.daemon.streams.clients import LocalClients, ZmqClients
from cm.daemon.streams.echo import Echoes
from cm.daemon.streams.memory_thread import MemoryThread
from cm.daemon.streams.peer import Peer
from cm.daemon.streams.policy import StreamEvent, StreamPolicy, Users
from cm.daemon.streams.stalled import StalledChannels
from cm.daemon.streams.stream import OpenStream
from cm.device import DeviceTimeout
from cm.device.data_plane import ClientGone, ClientLeaves, Plane
from cm.errors import CmError
from cm.messages.status import ErrorInfo
from cm.metrics.counts import Moved, StreamTotals
from cm.schema.model import Direction, Stream

_LOG = logging.getLogger(__name__)


class StreamDriver:
    """The open streams, their clients, and the plane that moves the frames."""

    def __init__(
        self,
        loop: Loop,
        devices: BoardDevices,
        audience: Audience,
        policy: StreamPolicy,
        on_error: Callable[[ErrorInfo], None],
        slots_each: int,
    ) -> None:
        self._slots_each = slots_each
        self._loop = loop
        self._devices = devices
        self._audience = audience
        self._policy = policy
        self._on_error = on_error
        self.plane = Plane()
        self._thread = MemoryThread(loop)
        self.echoes = Echoes(self.plane, self._thread)
        self.allocations = Allocations(self.plane, self._thread, devices.port_memory, devices.memory)
        self.open: dict[str, OpenStream] = {}
        self._totals = StreamTotals()
        self.failures: dict[str, ErrorInfo] = {}  # of streams of this mode: why the last time was not a success
        self.locals = LocalClients(self.plane, on_error)
        self.zmq = ZmqClients(loop, self.plane, audience.frame, self._see_to)
        self._beside = Beside(loop)
        self._stalled = StalledChannels(devices.probe_dma)
        loop.add(self.plane.fileno(), self._plane_event)

    def renew(self, slots_each: int) -> None:
        """So many slots of a stream are for one process from now on."""
        self._slots_each = slots_each
        for opened in self.open.values():
            opened.joiners.each = slots_each

    def refresh(self) -> None:
        """Open what is wanted, close what is not wanted any more."""
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
        """Who uses a stream now."""
        return Users(self.has_subscriber(stream), self.locals.use(stream.name), self.zmq.busy(stream.name))

    def has_subscriber(self, stream: Stream) -> bool:
        """Whether a stream's frames are subscribed to."""
        return stream.direction is Direction.S2MM and self._audience.wants_stream(stream.name)

    def settle(self) -> None:
        """Clients that have just hung up do not use their stream any more when this returns."""
        self.plane.settle()
        self._plane_event()

    def running(self, stream: Stream, first: Callable[[OpenStream], object] = lambda _: None) -> OpenStream:
        """A stream, opened where it is not: it starts in a later turn. Raises StreamStopped, Timeout, DeviceError."""
        self._policy.check_may_run(stream.name)
        return self.open.get(stream.name) or self._start(stream, first)

    def attach(
        self, stream: Stream, client: int, depth: int, peer: Peer, stopped: Callable[[int], object]
    ) -> Iterator[None]:
        """The steps for a client to join a stream that runs or may run; else it waits, and is `stopped`.

        They raise NoSlots, DeviceError; a stream that cannot start then is closed.
        """
        opened = self.open.get(stream.name)
        if opened is not None:
            return self._watched(opened, opened.joiners.join(client, depth, peer, stopped))
        if not self._policy.may_run(stream.name):
            stopped(0)
            return iter(())
        steps: list[Iterator[None]] = []
        opened = self._start(stream, lambda o: steps.append(o.joiners.join(client, depth, peer, stopped)), paid=True)
        return self._watched(opened, steps[0])

    def _watched(
        self, opened: OpenStream, steps: Iterator[None], failed: Callable[[CmError | OSError], object] | None = None
    ) -> Iterator[None]:
        """Take steps; what goes wrong is `failed`'s, or raised, and ends a stream that did not start yet."""
        try:
            yield from steps
        except (CmError, OSError) as error:
            if failed is not None:
                failed(error)
            self._not_started(opened, error)
            if failed is None:
                raise

    def _see_to(self, opened: OpenStream, steps: Iterator[None], failed: Callable[[CmError | OSError], object]) -> None:
        """The same in turns of the daemon's own."""
        self._beside.run(self._watched(opened, steps, failed))

    def _not_started(self, opened: OpenStream, error: CmError | OSError) -> None:
        """Close a stream that has no slots to start with; one that runs goes on without its new client."""
        name, late = opened.stream.name, isinstance(error, DeviceTimeout)
        if not opened.joiners.started and self.open.get(name) is opened:
            opened.joiners.fail(error)
            self.zmq.close(name, error)
            (self._stall if late else self.stop)(name, errno.ETIMEDOUT if late else 0)

    def stop(self, name: str, error: int = 0) -> None:
        """Close a stream, if it is open; `error` (an errno) is what its clients are told."""
        opened = self.open.pop(name, None)
        if opened is None:
            return
        self._policy.after(name, StreamEvent.CLOSE)
        self._totals.add(name, opened.moved())
        failure = opened.failure()
        if failure is not None:
            self.failures[name] = failure
        try:
            opened.close(error)
        finally:
            self.zmq.close(name)

    def moved(self) -> dict[str, Moved]:
        """What each stream moved since the manager's start, however often it was opened."""
        return self._totals.with_ended({name: opened.moved() for name, opened in self.open.items()})

    def _failed(self, name: str, error: ErrorInfo) -> None:
        self.failures[name] = error
        self._on_error(error)

    def close(self) -> None:
        """Hang up on all clients, end the plane's thread."""
        for held in (self._stalled, self.allocations, self._thread):
            held.close()
        self._loop.remove(self.plane.fileno())
        self.plane.close()

    def _start(
        self, stream: Stream, first: Callable[[OpenStream], object] = lambda _: None, paid: bool = False
    ) -> OpenStream:
        """Open a stream for its clients and what `first` attaches, whose steps are those to its start if `paid`."""
        opened = self._opened(stream)
        try:
            config, mode = self._policy.config, self._policy.mode
            opened.label(config.name if config else "", mode or "")
            waiting = self.locals.attach_all(opened)
            first(opened)
            self.zmq.refresh(opened, self.has_subscriber(stream))
            for client, steps in waiting:
                self._see_to(opened, steps, partial(self.locals.refused, opened, client))
            if not paid:
                self._see_to(opened, opened.joiners.begin(), partial(self._unopened, stream.name))
        except BaseException:
            self.stop(stream.name)
            raise
        return opened

    def _opened(self, stream: Stream) -> OpenStream:
        try:
            opened = OpenStream(self.plane, self._devices.dma(stream.channel), stream, self._slots_each)
        except DeviceTimeout:
            with suppress(OSError):  # then the next client that opens it finds out anew
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
        """As `_stop`, for a channel that does not answer: it is kept, and asked whether it does again."""
        opened = self.open.pop(name)
        self._totals.add(name, opened.moved())
        self._policy.after(name, StreamEvent.STALL)
        self._stalled.begin(name, opened.release(error))
        self.zmq.close(name)

    def _plane_event(self) -> None:
        while (event := self.plane.event()) is not None:
            if isinstance(event, ClientGone):
                self._client_gone(event.client)
            elif isinstance(event, ClientLeaves):
                self.locals.leaves(event.client)
                self.refresh()
            else:
                self._lost(event.stream, event.error)

    def _client_gone(self, client: int) -> None:
        self.echoes.gone(client)
        self.allocations.gone(client)
        opened = self.open.get(self.locals.gone(client) or "")
        if opened is not None:
            opened.joiners.detached(client)
        self.refresh()

    def _lost(self, number: int, error: int) -> None:
        for name in [name for name, opened in self.open.items() if opened.id == number]:
            text = os.strerror(error)
            _LOG.warning("stream %s ended: %s", name, text)
            if error == errno.ETIMEDOUT:
                self._stall(name, error)
            else:
                self.stop(name, error)
            self._failed(name, ErrorInfo("device_error", f"stream {name!r} ended: {text}"))
