# SPDX-License-Identifier: Apache-2.0
"""The streams of the loaded mode, for requests and for the manager: what `lifecycle` decides is carried out here.

Their clients are other processes, over the data socket, and the manager itself for ZeroMQ. All runs in the loop's
thread.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from typing import Protocol

from cm.device import DeviceTimeout
from cm.device.data_plane import ClientGone, ClientLeaves, Plane
from cm.errors import Busy, CmError
from cm.frozen import replace
from cm.manager.access.leases import Leases
from cm.manager.status_reports import stream_status
from cm.schema.model import Config, Direction, Stream
from cm.server.client_process import Peer
from cm.server.connections import Connections
from cm.server.devices import BoardDevices
from cm.server.error_replies import error_info
from cm.server.long_work import NOT_YET, RoundRobin
from cm.server.settings.model import USUAL, Limits
from cm.server.sockets import Loop
from cm.server.streams.channel_setup import changed, setup
from cm.server.streams.client_memory import ClientMemories
from cm.server.streams.lifecycle import StreamLifecycle, StreamStopped
from cm.server.streams.machine import OPEN_PHASES, NoSlots, Step, StreamEvent, StreamPhase
from cm.server.streams.over_zmq import ZmqReader, ZmqWriter
from cm.server.streams.stream import Done, Frame, OpenStream
from cm.wire.messages.requests import ConfigureStream
from cm.wire.messages.status import ErrorInfo, StreamStatus
from cm.wire.plane_packets import STOPPED, Descriptor, Open, Purpose


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


class Streams:
    """The open streams, their clients, and the plane that moves the frames.

    Implements `cm.manager.interfaces.DataPlane`, and the requests that concern streams.
    """

    def __init__(
        self,
        loop: Loop,
        devices: BoardDevices,
        subscribers: Subscribers,
        leases: Leases,
        rights: Connections,
        on_error: Callable[[ErrorInfo], None],
        turns: RoundRobin,
        limits: Limits = USUAL,
    ) -> None:
        self._loop = loop
        self._devices = devices
        self._subscribers = subscribers
        self._leases = leases
        self._on_error = on_error
        self._turns = turns
        self._lifecycle = StreamLifecycle()
        self._plane = Plane()
        self.wrote = self._plane.wrote
        self.memories = ClientMemories(loop, self._plane, devices.port_memory, devices.memory, limits)
        self._open: dict[str, OpenStream] = {}
        self._ours: dict[str, ZmqReader | ZmqWriter] = {}  # our own clients, for ZeroMQ, by their stream
        self._failures: dict[str, ErrorInfo] = {}  # by stream of this mode: why it last failed
        self._idle: dict[str, tuple[Stream, StreamStatus]] = {}
        self._rights = rights
        self.limits = limits
        loop.add(self._plane.fileno(), self._plane_event)

    def close(self) -> None:
        """Stop all streams."""
        for name in list(self._open):
            self._stop(name)

    def end(self) -> None:
        """Stop all streams, disconnect all clients, and end the plane's thread."""
        self.close()
        self.memories.close()
        self._loop.remove(self._plane.fileno())
        self._plane.close()

    # ---- DataPlane: called by the worker ----------------------------------------------

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop streams; when this returns, their transfers have ended."""

        def hold() -> None:
            for name in streams:
                self._stop(name)
                self._lifecycle.machine(name).after(StreamEvent.HOLD)

        self._loop.ask(hold)

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        """Switch to the streams of this mode; `held`: the module in each region."""
        self._loop.ask(lambda: self._enter(config, mode, held))

    def _enter(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        before, left = self._lifecycle.streams, self._lifecycle.config
        for name in self._lifecycle.enter(config, mode, held):
            self._stop(name)
        for name, stream in self._lifecycle.streams.items():  # a right, and a lease, is to the place where it was
            if config is not left or name not in before or before[name].region != stream.region:
                self._end_forbidden(stream)
        self._idle.clear()
        self._failures.clear()
        for opened in self._open.values():
            opened.label(config.name if config else "", mode or "")
        self.refresh()

    def _end_forbidden(self, stream: Stream) -> None:
        """Hang up on the clients that may not have a stream where this mode has it."""
        machine = self._lifecycle.machine(stream.name)
        for member in list(machine.members.values()):
            try:
                member.check(stream)
            except CmError as error:
                _LOG.warning("a client of stream %s was hung up on: %s", stream.name, error)
                member.error = error
                machine.left(member.client)
                self._plane.drop(member.client)

    # ---- requests -----------------------------------------------------------------------

    def named(self, name: str, direction: Direction | None) -> Stream:
        """Return a stream by name, or the only one of a direction. Raises UnknownStream, NothingLoaded."""
        return self._lifecycle.named(name, direction)

    def check_lease(self, stream: Stream, lease: str) -> None:
        """Raise HeldBy if a stream's region is leased and `lease` is not that lease."""
        self._leases.check((f"region:{stream.region}" if stream.region else "streams",), lease)

    def configure(self, request: ConfigureStream, done: Callable[[StreamStatus | Exception], None]) -> None:
        """Change a stream that is not in use, or by force; call `done` once it runs again, if it is wanted.

        Raises UnknownStream, InvalidRequest, Busy; a change that the channel refuses, here or later, is undone.
        """
        stream = self.named(request.stream, None)
        name, wanted = stream.name, changed(stream, request)
        if wanted != stream:
            if not request.force and self._in_use(stream):
                raise Busy(f"stream {name!r} is in use; close its readers, or force the change")
            self._check_channel(wanted)
            self._stop(name)
        take_back = self._lifecycle.override(stream, wanted, request)

        def ended(error: Exception | None) -> None:
            if error is not None:
                take_back()
            if error is None and name not in self._lifecycle.streams:
                error = StreamStopped(f"stream {name!r} was stopped: this mode has none of that name")
            done(error or self.status_of(name))

        try:
            if self._lifecycle.is_wanted(wanted, self._is_used(wanted)) and not self._lifecycle.is_held(name):
                self._running(wanted)
        except BaseException:  # a change that the channel refuses is undone
            take_back()
            self.refresh()
            raise
        self.refresh()
        opened = self._open.get(name)
        if opened is None:
            ended(None)
        else:
            opened.when_started(ended)

    def _in_use(self, stream: Stream) -> bool:
        """Whether a client would notice a change; a stream that only lingers after its last client is not in use."""
        self._settle()
        machine, ours = self._lifecycle.machine(stream.name), self._ours.get(stream.name)
        if machine.phase in (StreamPhase.CLOSED, StreamPhase.RESTING):
            return False
        busy = self._lifecycle.set_to_run(stream.name) or (ours is not None and ours.working)
        return busy or machine.is_used or self._has_subscriber(stream)

    def _check_channel(self, stream: Stream) -> None:
        """Raise InvalidRequest for what the channel cannot do, even if it is not open yet."""
        opened = self._open.get(stream.name)
        if self._lifecycle.is_silent(stream.name):
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
        reader = self._own_client(self._running(self.named(name, Direction.S2MM)))
        assert isinstance(reader, ZmqReader)
        reader.read_once(timeout or 1.0, done)

    def write(self, name: str, data: bytes | memoryview, done: Done, lease: str = "") -> None:
        """Send a frame; call `done` when the hardware has taken it. Raises InvalidRequest, Busy, HeldBy."""
        stream = self.named(name, Direction.MM2S)
        self.check_lease(stream, lease)
        writer = self._own_client(self._running(stream))
        assert isinstance(writer, ZmqWriter)
        writer.write(data, done)

    def _own_client(self, opened: OpenStream) -> ZmqReader | ZmqWriter:
        """Our own client of an open stream, made when it is needed: it passes frames over ZeroMQ."""
        client = self._ours.get(opened.stream.name)
        if client is None:
            if opened.writes:
                client = ZmqWriter(self._loop, self._plane, opened)
            else:
                client = ZmqReader(self._loop, self._plane, opened, self._subscribers.frame)
            self._ours[opened.stream.name] = client
            self._drive(opened)
        return client

    def _close_own_client(self, name: str, error: Exception | None = None) -> None:
        """Waiting requests get the error, or are told that the stream was stopped."""
        client = self._ours.pop(name, None)
        if client is not None:
            client.close(error)

    def open_local(self, connection: socket.socket, wanted: Open, peer: Peer) -> Iterator[object]:
        """Return the steps that make a connection a client of a stream; the caller closes the connection.

        They raise UnknownStream, NoSlots, DeviceError; also HeldBy, if the region is leased to another client and this
        one would write, or could hold up the hardware. Where the stream may not run now, or is stopped meanwhile, its
        client is told so and waits for it.
        """
        reads, who = wanted.purpose is Purpose.READ, self._rights.whose(connection)
        direction = {Purpose.READ: Direction.S2MM, Purpose.WRITE: Direction.MM2S}.get(wanted.purpose)
        stream = self.named(wanted.name, direction)

        def check_lease(now: Stream) -> None:
            if not reads or now.backpressure:
                self.check_lease(now, wanted.lease)

        def check(now: Stream) -> None:
            self._rights.check_open(who, wanted)
            check_lease(now)

        def stopped(error: int) -> None:
            with suppress(OSError):  # so that the client need not infer it from silence; it may have gone
                connection.send(Descriptor(kind=STOPPED, offset=error).pack())

        check_lease(stream)
        client, machine = self._plane.adopt(os.dup(connection.fileno())), self._lifecycle.machine(stream.name)
        try:
            lends = wanted.purpose is Purpose.TRANSFER
            if lends or machine.is_lent:
                self._make_way(stream)
            member = machine.join(client, wanted.depth, peer, self.limits.slots_each, stopped, lends)
            member.check = check
            if not self._lifecycle.may_run(stream.name) and stream.name not in self._open:
                member.settled = True
                stopped(0)
                return
            self._drive(self._open.get(stream.name) or self._open_stream(stream))
            while not member.settled:
                yield NOT_YET
            if member.error is not None:
                raise member.error
        except BaseException:
            machine.left(client)
            self._plane.drop(client)
            raise

    def _make_way(self, stream: Stream) -> None:
        """Stop a stream that nobody uses: its next client wants it in another way. Raises Busy."""
        self._settle()
        ours = self._ours.get(stream.name)
        if (ours is not None and ours.working) or self._has_subscriber(stream):
            raise Busy(f"stream {stream.name!r} is in use over ZeroMQ: a client's transfers have it alone")
        if not self._lifecycle.machine(stream.name).is_used:
            self._stop(stream.name)

    def _settle(self) -> None:
        """Process the disconnections that have already happened, so that those clients no longer count as users."""
        self._plane.settle()
        self._plane_event(sys.maxsize)  # each client has two at most

    # ---- what runs ------------------------------------------------------------------------

    def refresh(self) -> None:
        """Open streams that are wanted, and close those that are no longer wanted."""
        for opened in list(self._open.values()):
            if opened.machine.lent != opened.machine.is_lent:  # the next user opens it in the other way
                self._stop(opened.stream.name)
        for event, stream in self._lifecycle.due(self._is_used):
            if event is StreamEvent.CLOSE:
                self._stop(stream.name)
                continue
            try:
                self._open_stream(stream)
            except (CmError, OSError) as error:
                machine = self._lifecycle.machine(stream.name)
                if machine.phase is StreamPhase.CLOSED:
                    machine.after(StreamEvent.FAIL)
                self._could_not_open(stream.name, error)
        for name, opened in list(self._open.items()):
            client, subscribed = self._ours.get(name), self._has_subscriber(opened.stream)
            if opened.machine.lent:
                continue
            if client is None and subscribed:
                self._own_client(opened)
            elif client is not None and not client.busy and not subscribed:
                self._close_own_client(name)

    def _is_used(self, stream: Stream) -> bool:
        """By a subscriber, by a client of the data socket, or by a single transfer, now or a moment ago."""
        client = self._ours.get(stream.name)
        local = self._lifecycle.machine(stream.name).is_used
        return local or self._has_subscriber(stream) or (client is not None and client.busy)

    def _has_subscriber(self, stream: Stream) -> bool:
        return stream.direction is Direction.S2MM and self._subscribers.wants_stream(stream.name)

    def _running(self, stream: Stream) -> OpenStream:
        """A stream, opened if need be; it starts in a later turn. Raises StreamStopped, Timeout, DeviceError."""
        self._lifecycle.check_may_run(stream.name)
        if self._lifecycle.machine(stream.name).is_lent:
            raise Busy(f"stream {stream.name!r} is in use: a client transfers its own memory, and has it alone")
        return self._open.get(stream.name) or self._open_stream(stream)

    def _open_stream(self, stream: Stream) -> OpenStream:
        """Open a stream; its slots come in later turns."""
        machine, config = self._lifecycle.machine(stream.name), self._lifecycle.config
        try:
            opened = OpenStream(self._plane, self._devices.dma(stream.channel), stream, machine)
        except DeviceTimeout:
            if machine.phase is StreamPhase.CLOSED:
                machine.after(StreamEvent.FAIL)
            self._lifecycle.rest(stream.name, silent=True)
            raise
        self._open[stream.name] = opened
        machine.open(stream)
        opened.label(config.name if config else "", self._lifecycle.mode or "")
        self._drive(opened)
        return opened

    def _drive(self, opened: OpenStream) -> None:
        """Take the steps that a stream needs next, in turns of the loop, unless they are being taken."""
        if not opened.driven:
            opened.driven = True
            self._turns.run(self._steps(opened))

    def _steps(self, opened: OpenStream) -> Iterator[None]:
        try:
            while (step := opened.machine.next()) is not None and self._open.get(opened.stream.name) is opened:
                try:
                    opened.take(step)
                except (CmError, OSError) as error:
                    self._refuse(opened, step, error)
                yield
        finally:
            opened.driven = False

    def _refuse(self, opened: OpenStream, step: Step, error: CmError | OSError) -> None:
        """A step could not be taken: tell those whom it concerns, and close the stream if it cannot run.

        Of our own client the requests that wait get the error, and subscribers find it reported; where the stream does
        not run, that is reported instead.
        """
        machine, name = opened.machine, opened.stream.name
        waited = [member.client for member in machine.members.values() if member.settled]
        refused = machine.failed(step, error, len(opened.slots))
        runs = machine.phase in OPEN_PHASES
        for member in refused:
            if member.ours:
                self._close_own_client(name, member.error or error)
                if runs:
                    said = f"frames of {name!r} do not pass over ZeroMQ: {member.error or error}"
                    self._on_error(ErrorInfo("no_slots", said))
            elif member.client in waited:
                self._plane.drop(member.client)
                self._on_error(ErrorInfo("no_slots", f"a client of {name!r} was hung up on: {member.error}"))
        if not runs:
            self._close(opened, errno.ETIMEDOUT if isinstance(error, DeviceTimeout) else 0, error)
            self._could_not_open(name, error, told=any(isinstance(member.error, NoSlots) for member in refused))

    def _stop(self, name: str, error: int = 0, event: StreamEvent = StreamEvent.CLOSE) -> None:
        """Close a stream if it is open, and tell its clients `error` (an errno, or 0)."""
        opened = self._open.get(name)
        if opened is not None:
            waiting = opened.machine.waiting
            opened.machine.after(event)
            for member in waiting:
                member.stopped(error)
            self._close(opened, error)

    def _close(self, opened: OpenStream, number: int, error: CmError | OSError | None = None) -> None:
        """Close a stream that is in another phase by now."""
        name = opened.stream.name
        del self._open[name]
        if (failure := opened.failure()) is not None:
            self._failures[name] = failure
        try:
            opened.close(number)
        finally:
            self._close_own_client(name, error)
            opened.started(error)

    def _could_not_open(self, name: str, error: CmError | OSError, told: bool = False) -> None:
        self._lifecycle.rest(name, silent=isinstance(error, DeviceTimeout))
        if not told:
            self._failed(name, ErrorInfo(error_info(error).code, f"stream {name!r} cannot be opened: {error}"))

    def _failed(self, name: str, error: ErrorInfo) -> None:
        self._failures[name] = error
        self._on_error(error)

    def _plane_event(self, most: int = _EVENTS) -> None:
        """Take some of the plane's events; it stays readable while there are more."""
        for taken in range(most):
            event = self._plane.event()
            if event is None:
                if not taken:
                    return
                break
            if isinstance(event, ClientGone):
                self.memories.gone(event.client)
                for machine in self._lifecycle.machines.values():
                    machine.left(event.client)
            elif isinstance(event, ClientLeaves):
                for machine in self._lifecycle.machines.values():
                    machine.leaves(event.client)
            else:
                self._lost(event.stream, event.error)
        self.refresh()

    def _lost(self, number: int, error: int) -> None:
        for name in [name for name, opened in self._open.items() if opened.id == number]:
            text, silent = os.strerror(error), error == errno.ETIMEDOUT
            _LOG.warning("stream %s ended: %s", name, text)
            self._stop(name, error, StreamEvent.FAIL if silent else StreamEvent.CLOSE)
            self._lifecycle.rest(name, silent)
            self._failed(name, ErrorInfo("device_error", f"stream {name!r} ended: {text}"))

    # ---- reports ----------------------------------------------------------------------

    def status(self) -> tuple[StreamStatus, ...]:
        """Report all streams of this mode."""
        return tuple([self.status_of(name) for name in self._lifecycle.streams])

    def status_of(self, name: str) -> StreamStatus:
        """Report one stream."""
        opened = self._open.get(name)
        status = opened.status() if opened else self._closed(self._lifecycle.streams[name])
        failure = status.last_error or self._failures.get(name)
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
        """Bytes of memory that clients of the data socket have, by client."""
        found = Counter[str]()
        for peer, size in self.memories.held():
            found[f"pid {peer.pid} ({peer.name})"] += size
        return found

    @property
    def any_open(self) -> bool:
        """Whether any stream is open."""
        return bool(self._open)
