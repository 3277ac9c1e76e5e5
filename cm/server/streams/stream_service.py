# SPDX-License-Identifier: Apache-2.0
"""The streams of the loaded mode, for requests and for the manager: what `policy` decides, carried out by `running`."""

from __future__ import annotations

import logging
import socket
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from cm.errors import Busy
from cm.manager.access.leases import Leases
from cm.manager.reporting import stream_status
from cm.schema.model import Config, Direction, Stream
from cm.server.devices import BoardDevices
from cm.server.limits import USUAL, Limits
from cm.server.loop import Loop
from cm.server.steps import Steps
from cm.server.streams.compression import check_compression
from cm.server.streams.peer import Peer
from cm.server.streams.policy import StreamEvent, StreamPhase, StreamPolicy
from cm.server.streams.running import RunningStreams, Subscribers
from cm.server.streams.settings import changed, setup
from cm.server.streams.stream import Done
from cm.wire.messages.requests import ConfigureStream
from cm.wire.messages.status import ErrorInfo, StreamStatus
from cm.wire.plane_packets import STOPPED, Descriptor, Open

_LOG = logging.getLogger(__name__)


class Streams:
    """Implements `cm.manager.interfaces.DataPlane`, and the requests that concern streams."""

    def __init__(
        self,
        loop: Loop,
        devices: BoardDevices,
        subscribers: Subscribers,
        leases: Leases,
        on_error: Callable[[ErrorInfo], None],
        steps: Steps,
        limits: Limits = USUAL,
    ) -> None:
        self._loop = loop
        self._devices = devices
        self._subscribers = subscribers
        self._leases = leases
        self._policy = StreamPolicy()
        self._driver = RunningStreams(loop, devices, subscribers, self._policy, on_error, limits.slots_each, steps)
        self.memories = self._driver.echoes, self._driver.allocations  # for clients that want no stream
        self.moved = self._driver.moved
        self._idle: dict[str, tuple[Stream, StreamStatus]] = {}
        self.renew(limits)

    def renew(self, limits: Limits) -> None:
        """Set other limits; clients keep what they have."""
        self._driver.renew(limits.slots_each)
        for memory in self.memories:
            memory.budget.renew(limits.memory_each_bytes, limits.memory_bytes)

    # ---- DataPlane: called by the worker ----------------------------------------------

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop streams; when this returns, their transfers have ended."""
        self._loop.ask(lambda: self._hold(streams))

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        """Switch to the streams of this mode; `held`: the module in each region."""
        self._loop.ask(lambda: self._enter(config, mode, held))

    def wrote(self, generation: int) -> None:
        """Note that registers were written, for frames to carry. May be called from any thread, and never waits."""
        self._driver.plane.wrote(generation)

    def _hold(self, names: Collection[str]) -> None:
        for name in names:
            self._driver.stop(name)
            self._policy.after(name, StreamEvent.HOLD)

    def _enter(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        for name in self._policy.enter(config, mode, held):
            self._driver.stop(name)
        self._idle.clear()
        self._driver.failures.clear()
        for opened in self._driver.open.values():
            opened.label(config.name if config else "", mode or "")
        self.refresh()

    # ---- requests: the loop's thread ----------------------------------------------------

    def refresh(self) -> None:
        """Open streams that are wanted, and close those that are no longer wanted."""
        self._driver.refresh()

    def named(self, name: str, direction: Direction | None) -> Stream:
        """Return a stream by name, or the only one of a direction. Raises UnknownStream, NothingLoaded."""
        return self._policy.named(name, direction)

    def check_lease(self, stream: Stream, lease: str) -> None:
        """Raise HeldBy if a stream's region is leased and `lease` is not that lease."""
        self._leases.check((f"region:{stream.region}" if stream.region else "streams",), lease)

    def configure(self, request: ConfigureStream, done: Callable[[StreamStatus | Exception], None]) -> None:
        """Change a stream that is not in use, or by force; call `done` once it runs again, if it is wanted.

        Raises UnknownStream, InvalidRequest, Busy; a change that the channel refuses, here or later, is undone.
        """
        stream = self.named(request.stream, None)
        check_compression(request.compression)
        wanted = changed(stream, request)
        if wanted != stream:
            if not request.force and self._in_use(stream):
                raise Busy(f"stream {stream.name!r} is in use; close its readers, or force the change")
            self._check_channel(wanted)
            self._driver.stop(stream.name)
        take_back = self._policy.override(stream, wanted, request)

        def ended(error: Exception | None) -> None:
            if error is not None:
                take_back()
            done(error or self.status_of(stream.name))

        try:
            if self._policy.is_wanted(wanted, self._driver.users(wanted)) and not self._policy.is_held(stream.name):
                self._driver.running(wanted)
        except BaseException:  # a change that the channel refuses is undone
            take_back()
            self.refresh()
            raise
        self.refresh()
        opened = self._driver.open.get(stream.name)
        if opened is None:
            ended(None)
        else:
            opened.holders.when_started(ended)

    def _in_use(self, stream: Stream) -> bool:
        """Whether a client would notice a change; a stream that only lingers after its last client is not in use."""
        self._driver.settle()
        if self._policy.phase(stream.name) in (StreamPhase.CLOSED, StreamPhase.STALLED):
            return False
        busy = self._policy.set_to_run(stream.name) or self._driver.zmq.working(stream.name)
        return busy or self._driver.has_subscriber(stream) or self._driver.locals.use(stream.name)

    def _check_channel(self, stream: Stream) -> None:
        """Raise InvalidRequest for what the channel cannot do, even if it is not open yet."""
        opened = self._driver.open.get(stream.name)
        if stream.name in self._policy.stalled():
            return
        try:
            if opened is not None:
                setup(opened.channel, stream)
            else:
                with self._devices.dma(stream.channel) as dma:
                    setup(dma.info, stream)
        except OSError as error:  # missing, or in use by another process: opening it will report that
            _LOG.info("stream %s: its channel cannot be asked: %s", stream.name, error)

    def read_once(self, name: str, timeout: float, done: Done) -> None:
        """Pass the next frame of a stream to `done`, or a Timeout after `timeout` seconds."""
        opened = self._driver.running(self.named(name, Direction.S2MM), self._driver.zmq.reader)
        self._driver.zmq.reader(opened).read_once(timeout or 1.0, done)

    def write(self, name: str, data: bytes | memoryview, done: Done, lease: str = "") -> None:
        """Send a frame; call `done` when the hardware has taken it. Raises InvalidRequest, Busy, HeldBy."""
        stream = self.named(name, Direction.MM2S)
        self.check_lease(stream, lease)
        self._driver.zmq.writer(self._driver.running(stream)).write(data, done)

    def open_local(self, connection: socket.socket, wanted: Open) -> Iterator[None]:
        """Return the steps that make a connection a reader or writer of a stream; the caller closes the connection.

        They raise UnknownStream, NoSlots, DeviceError; also HeldBy, if the region is leased to another client and this
        one would write, or could hold up the hardware.
        """
        stream = self.named(wanted.name, Direction.MM2S if wanted.write else Direction.S2MM)
        if wanted.write or stream.backpressure:
            self.check_lease(stream, wanted.lease)

        def stopped(error: int) -> None:
            with suppress(OSError):  # so that the client need not infer it from silence; it may have gone
                connection.send(Descriptor(kind=STOPPED, offset=error).pack())

        def join(client: int, peer: Peer) -> Iterator[None]:
            return self._driver.attach(stream, client, wanted.depth, peer, stopped)

        yield from self._driver.locals.adopt(connection, wanted, stream.name, join)

    def status(self) -> tuple[StreamStatus, ...]:
        """Report all streams of this mode."""
        return tuple([self.status_of(name) for name in self._policy.streams])

    def status_of(self, name: str) -> StreamStatus:
        """Report one stream."""
        opened = self._driver.open.get(name)
        status = opened.status() if opened else self._closed(self._policy.streams[name])
        failure = status.last_error or self._driver.failures.get(name)
        if failure is not None:
            status = replace(status, last_error=failure)
        overruns = self._subscribers.overruns(name)
        return replace(status, overruns=overruns) if overruns else status  # only if needed: half the work

    def _closed(self, stream: Stream) -> StreamStatus:
        """Report a stream that is not open; cached, as nothing in it changes until it opens or is set differently."""
        then, status = self._idle.get(stream.name) or (None, None)
        if then is not stream or status is None:
            status = stream_status(stream)
            self._idle[stream.name] = stream, status
        return status

    def allocated(self) -> Counter[str]:
        """Bytes of memory allocated for masters in the PL, by client."""
        held = self._driver.allocations.budget.held()
        return Counter({f"pid {peer.pid} ({peer.name})": size for peer, size in held.items()})

    @property
    def any_open(self) -> bool:
        """Whether any stream is open."""
        return bool(self._driver.open)

    def close(self) -> None:
        """Stop all streams."""
        for name in list(self._driver.open):
            self._driver.stop(name)

    def end(self) -> None:
        """Stop all streams, disconnect all clients, and end the plane's thread."""
        self.close()
        self._driver.close()
