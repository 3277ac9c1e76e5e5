# SPDX-License-Identifier: Apache-2.0
"""The streams of the loaded mode, for requests and for the manager: what `lifecycle` decides is carried out here.

Their clients are other processes, over the data socket, and the manager itself for ZeroMQ. All runs in the loop's
thread.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import socket
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Protocol

from cm.device import AxiDma, DeviceTimeout
from cm.device.data_plane import ClientGone, ClientLeaves, Plane
from cm.errors import Busy, CmError
from cm.frozen import replace
from cm.manager.access.leases import Leases
from cm.manager.status_reports import stream_status
from cm.schema.model import Config, Direction, Stream
from cm.server.devices import BoardDevices
from cm.server.long_work import NOT_YET, RoundRobin
from cm.server.settings.model import USUAL, Limits
from cm.server.sockets import Loop
from cm.server.streams.channel_setup import changed, setup
from cm.server.streams.client_memory import Allocations, Echoes, MemoryThread
from cm.server.streams.client_process import Peer
from cm.server.streams.data_socket import ConnectionRights
from cm.server.streams.lifecycle import StreamLifecycle, StreamStopped, Users
from cm.server.streams.machine import OPEN_PHASES, NoSlots, Step, StreamEvent, StreamPhase
from cm.server.streams.over_zmq import ZmqReader, ZmqWriter
from cm.server.streams.stream import Done, Frame, OpenStream
from cm.wire.messages.requests import ConfigureStream
from cm.wire.messages.status import ErrorInfo, StreamStatus
from cm.wire.plane_packets import STOPPED, Descriptor, Open, Purpose


class ZmqClients:
    """The daemon's own clients for ZeroMQ: at most one per stream, made when it is needed."""

    def __init__(
        self,
        loop: Loop,
        plane: Plane,
        deliver: Callable[[Frame], None],
        drive: Callable[[OpenStream], None],
        on_error: Callable[[ErrorInfo], None],
    ) -> None:
        """`drive` takes the steps by which a client gets its slots."""
        self._loop = loop
        self._plane = plane
        self._deliver = deliver
        self._drive = drive
        self._on_error = on_error
        self._clients: dict[str, ZmqReader | ZmqWriter] = {}

    def reader(self, opened: OpenStream) -> ZmqReader:
        """Return the client that reads an open stream."""
        client = self._clients.get(opened.stream.name)
        if not isinstance(client, ZmqReader):
            client = self._clients[opened.stream.name] = ZmqReader(self._loop, self._plane, opened, self._deliver)
            self._drive(opened)
        return client

    def writer(self, opened: OpenStream) -> ZmqWriter:
        """Return the client that writes to an open stream."""
        client = self._clients.get(opened.stream.name)
        if not isinstance(client, ZmqWriter):
            client = self._clients[opened.stream.name] = ZmqWriter(self._loop, self._plane, opened)
            self._drive(opened)
        return client

    def refuse(self, name: str, error: Exception, runs: bool) -> None:
        """There are no slots for this client: its waiting requests get the error, and subscribers find it reported.

        Where the stream does not run, that is reported instead.
        """
        self.close(name, error)
        if runs:
            self._on_error(ErrorInfo("no_slots", f"frames of {name!r} do not pass over ZeroMQ: {error}"))

    def busy(self, name: str) -> bool:
        """Whether a single read or write is under way, or was a moment ago."""
        client = self._clients.get(name)
        return client is not None and client.busy

    def working(self, name: str) -> bool:
        """Whether a single read or write is under way."""
        client = self._clients.get(name)
        return client is not None and client.working

    def refresh(self, opened: OpenStream, subscribed: bool) -> None:
        """Read frames while there are subscribers; close a client that has nothing to do."""
        client = self._clients.get(opened.stream.name)
        if client is None and subscribed:
            self.reader(opened)
        elif client is not None and not client.busy and not subscribed:
            self.close(opened.stream.name)

    def close(self, name: str, error: Exception | None = None) -> None:
        """Close a stream's client; waiting requests get the error, or are told that the stream was stopped."""
        client = self._clients.pop(name, None)
        if client is not None:
            client.close(error)


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
        lifecycle: StreamLifecycle,
        on_error: Callable[[ErrorInfo], None],
        slots_each: int,
        turns: RoundRobin,
    ) -> None:
        self._slots_each = slots_each
        self._loop = loop
        self._devices = devices
        self._subscribers = subscribers
        self._lifecycle = lifecycle
        self._on_error = on_error
        self.plane = Plane()
        self._thread = MemoryThread(loop)
        self.echoes = Echoes(self.plane, self._thread)
        self.allocations = Allocations(self.plane, self._thread, devices.port_memory, devices.memory)
        self.open: dict[str, OpenStream] = {}
        self.failures: dict[str, ErrorInfo] = {}  # by stream of this mode: why it last failed
        self.zmq = ZmqClients(loop, self.plane, subscribers.frame, self._drive, on_error)
        self._turns = turns
        self._stalled = StalledChannels(devices.probe_dma)
        loop.add(self.plane.fileno(), self._plane_event)

    def renew(self, slots_each: int) -> None:
        """Set how many slots of a stream one process may hold."""
        self._slots_each = slots_each

    def refresh(self) -> None:
        """Open streams that are wanted, and close those that are no longer wanted."""
        for name in self._stalled.answered() if self._lifecycle.stalled() else ():
            self._lifecycle.machine(name).after(StreamEvent.ANSWER)
        for opened in list(self.open.values()):
            if opened.machine.lent != opened.machine.is_lent:  # the next user opens it in the other way
                self.stop(opened.stream.name)
        for event, stream in self._lifecycle.due(self.users):
            if event is StreamEvent.CLOSE:
                self.stop(stream.name)
                continue
            try:
                self._open(stream)
            except (CmError, OSError) as error:
                machine = self._lifecycle.machine(stream.name)
                if machine.phase is StreamPhase.CLOSED:
                    machine.after(StreamEvent.FAIL)
                self._could_not_open(stream.name, error)
        for opened in list(self.open.values()):
            if not opened.machine.lent:
                self.zmq.refresh(opened, self.has_subscriber(opened.stream))

    def users(self, stream: Stream) -> Users:
        """Return who uses a stream now."""
        return Users(self.has_subscriber(stream), self.used_locally(stream), self.zmq.busy(stream.name))

    def used_locally(self, stream: Stream) -> bool:
        """Whether clients of the data socket want its frames, or want to write them."""
        return self._lifecycle.machine(stream.name).is_used

    def has_subscriber(self, stream: Stream) -> bool:
        """Whether the stream is an input with at least one subscriber."""
        return stream.direction is Direction.S2MM and self._subscribers.wants_stream(stream.name)

    def settle(self) -> None:
        """Process the disconnections that have already happened, so that those clients no longer count as users."""
        self.plane.settle()
        self._plane_event(sys.maxsize)  # each client has two at most

    def running(self, stream: Stream) -> OpenStream:
        """Return a stream, opened if need be; it starts in a later turn. Raises StreamStopped, Timeout, DeviceError."""
        self._lifecycle.check_may_run(stream.name)
        if self._lifecycle.machine(stream.name).is_lent:
            raise Busy(f"stream {stream.name!r} is in use: a client transfers its own memory, and has it alone")
        return self.open.get(stream.name) or self._open(stream)

    def end_forbidden(self, stream: Stream) -> None:
        """Hang up on the clients that may not have a stream where this mode has it."""
        machine = self._lifecycle.machine(stream.name)
        for member in list(machine.members.values()):
            try:
                member.check(stream)
            except CmError as error:
                _LOG.warning("a client of stream %s was hung up on: %s", stream.name, error)
                member.error = error
                machine.left(member.client)
                self.plane.drop(member.client)

    def join(
        self, stream: Stream, connection: socket.socket, wanted: Open, peer: Peer, check: Callable[[Stream], object]
    ) -> Iterator[object]:
        """Make a connection a client of a stream, and wait until it has its slots; the caller closes the connection.

        Where the stream may not run now, or is stopped meanwhile, its client is told so and waits for it. `check`
        raises what forbids it the stream elsewhere. Raises that, NoSlots, DeviceError; then it is no client.
        """

        def stopped(error: int) -> None:
            with suppress(OSError):  # so that the client need not infer it from silence; it may have gone
                connection.send(Descriptor(kind=STOPPED, offset=error).pack())

        client, machine = self.plane.adopt(os.dup(connection.fileno())), self._lifecycle.machine(stream.name)
        try:
            lends = wanted.purpose is Purpose.TRANSFER
            if lends or machine.is_lent:
                self._make_way(stream)
            member = machine.join(client, wanted.depth, peer, self._slots_each, stopped, lends)
            member.check = check
            if not self._lifecycle.may_run(stream.name) and stream.name not in self.open:
                member.settled = True
                stopped(0)
                return
            self._drive(self.open.get(stream.name) or self._open(stream))
            while not member.settled:
                yield NOT_YET
            if member.error is not None:
                raise member.error
        except BaseException:
            machine.left(client)
            self.plane.drop(client)
            raise

    def _make_way(self, stream: Stream) -> None:
        """Stop a stream that nobody uses: its next client wants it in another way. Raises Busy."""
        self.settle()
        if self.zmq.working(stream.name) or self.has_subscriber(stream):
            raise Busy(f"stream {stream.name!r} is in use over ZeroMQ: a client's transfers have it alone")
        if not self._lifecycle.machine(stream.name).is_used:
            self.stop(stream.name)

    def _open(self, stream: Stream) -> OpenStream:
        """Open a stream; its slots come in later turns."""
        machine = self._lifecycle.machine(stream.name)
        try:
            opened = OpenStream(self.plane, self._devices.dma(stream.channel), stream, machine)
        except DeviceTimeout:
            with suppress(OSError):  # if it cannot be watched, the next client to open it finds out again
                self._stalled.probe(stream)
                machine.after(StreamEvent.STALL)
            raise
        self.open[stream.name] = opened
        machine.open(stream)
        config = self._lifecycle.config
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
            while (step := opened.machine.next()) is not None and self.open.get(opened.stream.name) is opened:
                try:
                    opened.take(step)
                except (CmError, OSError) as error:
                    self._refuse(opened, step, error)
                yield
        finally:
            opened.driven = False

    def _refuse(self, opened: OpenStream, step: Step, error: CmError | OSError) -> None:
        """A step could not be taken: tell those whom it concerns, and close the stream if it cannot run."""
        machine, name = opened.machine, opened.stream.name
        waited = [member.client for member in machine.members.values() if member.settled]
        refused = machine.failed(step, error, len(opened.slots))
        runs = machine.phase in OPEN_PHASES
        for member in refused:
            if member.ours:
                self.zmq.refuse(name, member.error or error, runs)
            elif member.client in waited:
                self.plane.drop(member.client)
                self._on_error(ErrorInfo("no_slots", f"a client of {name!r} was hung up on: {member.error}"))
        if not runs:
            self._close(opened, errno.ETIMEDOUT if isinstance(error, DeviceTimeout) else 0, error)
            self._could_not_open(name, error, told=any(isinstance(member.error, NoSlots) for member in refused))

    def stop(self, name: str, error: int = 0, event: StreamEvent = StreamEvent.CLOSE) -> None:
        """Close a stream if it is open, and tell its clients `error` (an errno, or 0)."""
        opened = self.open.get(name)
        if opened is not None:
            waiting = opened.machine.waiting
            opened.machine.after(event)
            for member in waiting:
                member.stopped(error)
            self._close(opened, error)

    def _close(self, opened: OpenStream, number: int, error: CmError | OSError | None = None) -> None:
        """Close a stream that is in another phase by now; a channel that does not answer is watched until it does."""
        name = opened.stream.name
        del self.open[name]
        if (failure := opened.failure()) is not None:
            self.failures[name] = failure
        try:
            if opened.machine.phase is StreamPhase.STALLED:
                self._stalled.begin(name, opened.release(number))
            else:
                opened.close(number)
        finally:
            self.zmq.close(name, error)
            opened.started(error)

    def _failed(self, name: str, error: ErrorInfo) -> None:
        self.failures[name] = error
        self._on_error(error)

    def close(self) -> None:
        """Disconnect all clients and end the plane's thread."""
        for held in (self._stalled, self.allocations, self._thread):
            held.close()
        self._loop.remove(self.plane.fileno())
        self.plane.close()

    def _could_not_open(self, name: str, error: CmError | OSError, told: bool = False) -> None:
        self._lifecycle.rest(name)
        if not told:
            code = error.code if isinstance(error, CmError) else "device_error"
            self._failed(name, ErrorInfo(code, f"stream {name!r} cannot be opened: {error}"))

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
                for machine in self._lifecycle.machines.values():
                    machine.leaves(event.client)
            else:
                self._lost(event.stream, event.error)
        self.refresh()

    def _client_gone(self, client: int) -> None:
        self.echoes.gone(client)
        self.allocations.gone(client)
        for machine in self._lifecycle.machines.values():
            machine.left(client)

    def _lost(self, number: int, error: int) -> None:
        for name in [name for name, opened in self.open.items() if opened.id == number]:
            text = os.strerror(error)
            _LOG.warning("stream %s ended: %s", name, text)
            self.stop(name, error, StreamEvent.STALL if error == errno.ETIMEDOUT else StreamEvent.CLOSE)
            self._failed(name, ErrorInfo("device_error", f"stream {name!r} ended: {text}"))


class Streams:
    """Implements `cm.manager.interfaces.DataPlane`, and the requests that concern streams."""

    def __init__(
        self,
        loop: Loop,
        devices: BoardDevices,
        subscribers: Subscribers,
        leases: Leases,
        on_error: Callable[[ErrorInfo], None],
        turns: RoundRobin,
        limits: Limits = USUAL,
    ) -> None:
        self._loop = loop
        self._devices = devices
        self._subscribers = subscribers
        self._leases = leases
        self._lifecycle = StreamLifecycle()
        self._driver = RunningStreams(loop, devices, subscribers, self._lifecycle, on_error, limits.slots_each, turns)
        self.memories = self._driver.echoes, self._driver.allocations  # for clients that want no stream
        self.wrote = self._driver.plane.wrote
        self._idle: dict[str, tuple[Stream, StreamStatus]] = {}
        self._rights: ConnectionRights
        self.renew(limits)

    def begin(self, rights: ConnectionRights) -> None:
        """Ask this for the rights of clients of the data socket, from before the first one."""
        self._rights = rights

    def renew(self, limits: Limits) -> None:
        """Set other limits; clients keep what they have."""
        self._driver.renew(limits.slots_each)
        for memory in self.memories:
            memory.budget.renew(limits.memory_each_bytes, limits.memory_bytes)

    # ---- DataPlane: called by the worker ----------------------------------------------

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop streams; when this returns, their transfers have ended."""

        def hold() -> None:
            for name in streams:
                self._driver.stop(name)
                self._lifecycle.machine(name).after(StreamEvent.HOLD)

        self._loop.ask(hold)

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        """Switch to the streams of this mode; `held`: the module in each region."""
        self._loop.ask(lambda: self._enter(config, mode, held))

    def _enter(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        before, left = self._lifecycle.streams, self._lifecycle.config
        for name in self._lifecycle.enter(config, mode, held):
            self._driver.stop(name)
        for name, stream in self._lifecycle.streams.items():  # a right, and a lease, is to the place where it was
            if config is not left or name not in before or before[name].region != stream.region:
                self._driver.end_forbidden(stream)
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
        return self._lifecycle.named(name, direction)

    def check_lease(self, stream: Stream, lease: str) -> None:
        """Raise HeldBy if a stream's region is leased and `lease` is not that lease."""
        self._leases.check((f"region:{stream.region}" if stream.region else "streams",), lease)

    def configure(self, request: ConfigureStream, done: Callable[[StreamStatus | Exception], None]) -> None:
        """Change a stream that is not in use, or by force; call `done` once it runs again, if it is wanted.

        Raises UnknownStream, InvalidRequest, Busy; a change that the channel refuses, here or later, is undone.
        """
        stream = self.named(request.stream, None)
        wanted = changed(stream, request)
        if wanted != stream:
            if not request.force and self._in_use(stream):
                raise Busy(f"stream {stream.name!r} is in use; close its readers, or force the change")
            self._check_channel(wanted)
            self._driver.stop(stream.name)
        take_back = self._lifecycle.override(stream, wanted, request)

        def ended(error: Exception | None) -> None:
            if error is not None:
                take_back()
            if error is None and stream.name not in self._lifecycle.streams:
                error = StreamStopped(f"stream {stream.name!r} was stopped: this mode has none of that name")
            done(error or self.status_of(stream.name))

        try:
            if self._lifecycle.is_wanted(wanted, self._driver.users(wanted)) and not self._lifecycle.is_held(
                stream.name
            ):
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
            opened.when_started(ended)

    def _in_use(self, stream: Stream) -> bool:
        """Whether a client would notice a change; a stream that only lingers after its last client is not in use."""
        self._driver.settle()
        if self._lifecycle.machine(stream.name).phase in (StreamPhase.CLOSED, StreamPhase.RESTING, StreamPhase.STALLED):
            return False
        busy = self._lifecycle.set_to_run(stream.name) or self._driver.zmq.working(stream.name)
        return busy or self._driver.has_subscriber(stream) or self._driver.used_locally(stream)

    def _check_channel(self, stream: Stream) -> None:
        """Raise InvalidRequest for what the channel cannot do, even if it is not open yet."""
        opened = self._driver.open.get(stream.name)
        if stream.name in self._lifecycle.stalled():
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
        opened = self._driver.running(self.named(name, Direction.S2MM))
        self._driver.zmq.reader(opened).read_once(timeout or 1.0, done)

    def write(self, name: str, data: bytes | memoryview, done: Done, lease: str = "") -> None:
        """Send a frame; call `done` when the hardware has taken it. Raises InvalidRequest, Busy, HeldBy."""
        stream = self.named(name, Direction.MM2S)
        self.check_lease(stream, lease)
        self._driver.zmq.writer(self._driver.running(stream)).write(data, done)

    def open_local(self, connection: socket.socket, wanted: Open, peer: Peer) -> Iterator[object]:
        """Return the steps that make a connection a client of a stream; the caller closes the connection.

        They raise UnknownStream, NoSlots, DeviceError; also HeldBy, if the region is leased to another client and this
        one would write, or could hold up the hardware.
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

        check_lease(stream)
        yield from self._driver.join(stream, connection, wanted, peer, check)

    def status(self) -> tuple[StreamStatus, ...]:
        """Report all streams of this mode."""
        return tuple([self.status_of(name) for name in self._lifecycle.streams])

    def status_of(self, name: str) -> StreamStatus:
        """Report one stream."""
        opened = self._driver.open.get(name)
        status = opened.status() if opened else self._closed(self._lifecycle.streams[name])
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
