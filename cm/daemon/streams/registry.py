# SPDX-License-Identifier: Apache-2.0
"""The streams of the loaded mode: opened when somebody wants them, stopped while their region changes."""

from __future__ import annotations

import errno
import logging
import os
import socket
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Protocol

from cm.daemon.host.devices import BoardDevices
from cm.daemon.loop import Loop
from cm.daemon.streams.compression import check_compression
from cm.daemon.streams.echo import Echoes
from cm.daemon.streams.overrides import Choices
from cm.daemon.streams.settings import changed, setup
from cm.daemon.streams.stalled import Silence
from cm.daemon.streams.stream import Done, Frame, Peer, Pump, StreamStopped
from cm.daemon.streams.zmq_bridge import ReadTap, WriteTap
from cm.device.plane import ClientGone, ClientLeaves, Plane
from cm.errors import Busy, CmError, InvalidRequest, Timeout
from cm.manager.errors import NothingLoaded, UnknownStream
from cm.manager.planning.resolve import hint
from cm.manager.reporting.descriptions import stream_status
from cm.messages.requests import ConfigureStream
from cm.messages.status import ErrorInfo, StreamStatus
from cm.schema.model import Config, Direction, Stream
from cm.wire.plane import Open

_LOG = logging.getLogger(__name__)


class Sink(Protocol):
    """Takes frames; the frame's memory is valid during the call only."""

    def frame(self, frame: Frame) -> None:
        """A frame came."""


@dataclass(frozen=True, slots=True)
class _Local:
    """A client of the plane in another process; it stays one while its stream is stopped."""

    stream: str
    depth: int
    peer: Peer
    leaving: bool = False  # it only holds frames yet


class Streams:
    """`cm.manager.ports.DataPlane`, and what requests ask of streams."""

    def __init__(self, loop: Loop, devices: BoardDevices, on_error: Callable[[ErrorInfo], None]) -> None:
        self._loop = loop
        self._devices = devices
        self._on_error = on_error
        self._sinks: list[Sink] = []
        self._config: Config | None = None
        self._mode: str | None = None
        self._streams: dict[str, Stream] = {}
        self._choices = Choices()
        self._plane = Plane()
        self.echoes = Echoes(self._plane)
        self._pumps: dict[str, Pump] = {}
        self._taps: dict[str, ReadTap | WriteTap] = {}
        self._locals: dict[int, _Local] = {}  # clients of the plane
        self._held: set[str] = set()  # stopped while their region changes
        self._wanted: Callable[[str], bool] = lambda _: False
        self._overruns: Callable[[str], int] = lambda _: 0
        self._check_lease: Callable[[tuple[str, ...], str], None] = lambda _, __: None
        self._silence = Silence(devices.probe_dma)

    # ---- wiring -------------------------------------------------------------------

    def add_sink(self, sink: Sink) -> None:
        """Frames of all streams go to every sink."""
        self._sinks.append(sink)

    def wanted_by(
        self,
        wanted: Callable[[str], bool],
        overruns: Callable[[str], int] = lambda _: 0,
    ) -> None:
        """Who says whether somebody listens to a stream, and how often one fell behind."""
        self._wanted = wanted
        self._overruns = overruns

    def guarded_by(self, check: Callable[[tuple[str, ...], str], None]) -> None:
        """Who says whether a lease is needed: called with scopes and a lease's id, raises HeldBy."""
        self._check_lease = check

    def begin(self) -> None:
        """Listen to the plane's thread."""
        self._loop.add(self._plane.fileno(), self._plane_event)

    @property
    def plane(self) -> Plane:
        """The local data plane."""
        return self._plane

    # ---- DataPlane: called by the worker ----------------------------------------------

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop streams; their transfers have ended when this returns."""
        self._loop.ask(lambda: self._hold(streams))

    def resume(self, config: Config | None, mode: str | None) -> None:
        """The streams are those of this mode."""
        self._loop.ask(lambda: self._enter(config, mode))

    # ---- requests: the loop's thread ----------------------------------------------------

    def refresh(self) -> None:
        """Open what is wanted, close what nobody wants any more."""
        self._silence.look()
        for name, stream in self._streams.items():
            wanted = self._is_wanted(stream) and name not in self._held and not self._silence.of(name)
            if wanted and name not in self._pumps:
                self._open_quietly(stream)
            elif not wanted and name in self._pumps:
                self._close(name)
            if name in self._pumps:
                self._refresh_tap(stream)

    def configure(self, request: ConfigureStream) -> StreamStatus:
        """Change a stream; refused while it is in use unless forced. Raises UnknownStream, InvalidRequest, Busy."""
        stream = self.named(request.stream, None)
        check_compression(request.compression)
        wanted = changed(stream, request)
        if wanted != stream and not request.force and self._in_use(stream):
            raise Busy(f"stream {stream.name!r} is in use; close its readers, or force the change")
        if wanted != stream:
            self._check_channel(wanted)
            self._close(stream.name)
            self._streams[stream.name] = wanted
        take_back = self._choices.take(stream, wanted, request)
        try:
            if self._is_wanted(wanted) and stream.name not in self._held:
                self._running(wanted)
        except BaseException:  # a change that the channel refuses is none
            take_back()
            self._streams[stream.name] = stream
            self.refresh()
            raise
        self.refresh()
        return self.status_of(stream.name)

    def _in_use(self, stream: Stream) -> bool:
        """Whether somebody would notice a change; a stream that stays open a while for nobody is not in use."""
        self._plane.settle()
        self._plane_event()  # who has just closed its reader does not use it any more
        if stream.name not in self._pumps and stream.name not in self._held:
            return False
        tap = self._taps.get(stream.name)
        busy = bool(self._choices.runs(stream.name) or (tap and tap.working))
        return busy or self._has_subscriber(stream) or self._has_local(stream.name)

    def _check_channel(self, stream: Stream) -> None:
        """Raise InvalidRequest for what the channel cannot do, also where nobody uses it yet."""
        pump = self._pumps.get(stream.name)
        if self._silence.of(stream.name):
            return
        try:
            if pump is not None:
                setup(pump.channel, stream)
            else:
                with self._devices.dma(stream.channel) as dma:
                    setup(dma.info, stream)
        except OSError as error:  # not there now, or somebody else's: told when it is opened
            _LOG.info("stream %s: its channel cannot be asked: %s", stream.name, error)

    def named(self, name: str, direction: Direction | None) -> Stream:
        """A stream by name, or the only one of a direction. Raises UnknownStream, NothingLoaded."""
        if self._config is None:
            raise NothingLoaded("nothing is loaded, so there are no streams")
        if not name and direction is not None:
            fitting = [s for s in self._streams.values() if s.direction is direction]
            if len(fitting) == 1:
                return fitting[0]
            names = ", ".join(s.name for s in fitting) or "none"
            raise UnknownStream(f"name a stream; {direction.value} streams of this mode are {names}")
        stream = self._streams.get(name)
        if stream is None:
            raise UnknownStream(f"no stream {name!r} in mode {self._mode!r}{hint(name, self._streams)}")
        if direction is not None and stream.direction is not direction:
            raise InvalidRequest(f"stream {name!r} is {stream.direction.value}: it cannot be used the other way")
        return stream

    def read_once(self, name: str, timeout: float, done: Done) -> None:
        """Hand the next frame of a stream to `done`, or a Timeout."""
        pump = self._running(self.named(name, Direction.S2MM), lambda pump: bool(self._read_tap(pump)))
        self._read_tap(pump).read_once(timeout or 1.0, done)

    def write(self, name: str, data: bytes | memoryview, done: Done, lease: str = "") -> None:
        """Send a frame; `done` is called when the hardware has taken it. Raises InvalidRequest, Busy, HeldBy."""
        stream = self.named(name, Direction.MM2S)
        self.check_lease(stream, lease)
        pump = self._running(stream)
        tap = self._taps.get(pump.stream.name)
        if not isinstance(tap, WriteTap):
            tap = self._taps[pump.stream.name] = WriteTap(self._loop, self._plane, pump)
        tap.write(data, done)

    def open_local(self, connection: socket.socket, wanted: Open) -> None:
        """Make a connection to the data socket a reader or writer; the caller closes it.

        Raises UnknownStream, NoSlots; HeldBy for who writes, or could hold the hardware up, beside a lease.
        """
        stream = self.named(wanted.name, Direction.MM2S if wanted.write else Direction.S2MM)
        if wanted.write or stream.backpressure:
            self.check_lease(stream, wanted.lease)
        peer = Peer.of(connection)
        client = self._plane.adopt(os.dup(connection.fileno()))
        try:
            if stream.name in self._pumps:
                self._pumps[stream.name].attach(client, wanted.depth, peer)
            elif self._may_run(stream.name):
                self._open(stream, lambda pump: pump.attach(client, wanted.depth, peer))
            self._locals[client] = _Local(stream.name, wanted.depth, peer)
        except BaseException:
            self._plane.drop(client)
            raise

    def check_lease(self, stream: Stream, lease: str) -> None:
        """Raise HeldBy if somebody without `lease` must keep off a stream's region."""
        self._check_lease((f"region:{stream.region}" if stream.region else "streams",), lease)

    def status(self) -> tuple[StreamStatus, ...]:
        """All streams of this mode."""
        return tuple(self.status_of(name) for name in self._streams)

    def status_of(self, name: str) -> StreamStatus:
        """One stream."""
        pump = self._pumps.get(name)
        status = pump.status() if pump else stream_status(self._streams[name])
        overruns = self._overruns(name)
        return replace(status, overruns=overruns) if overruns else status  # not for nothing: it is half the work

    @property
    def any_open(self) -> bool:
        """Whether any stream runs."""
        return bool(self._pumps)

    def close(self) -> None:
        """Stop all."""
        for name in list(self._pumps):
            self._close(name)

    def end(self) -> None:
        """Stop all, hang up on all clients, end the plane's thread."""
        self.close()
        self._silence.close()
        self._loop.remove(self._plane.fileno())
        self._plane.close()

    # ---- inner ----------------------------------------------------------------------

    def _enter(self, config: Config | None, mode: str | None) -> None:
        streams = dict(config.modes[mode].streams) if config and mode is not None and mode in config.modes else {}
        if config is not None and (self._config is None or config.name != self._config.name):
            self._choices.config_changed()
        if mode != self._mode:
            self._choices.mode_changed()
        self._held.clear()
        self._config, self._mode = config, mode
        new = {n: self._choices.of(s) for n, s in streams.items()}
        for name in list(self._pumps):
            if new.get(name) != self._streams.get(name):
                self._close(name)
        self._streams = new
        for pump in self._pumps.values():
            pump.label(config.name if config else "", mode or "")
        self.refresh()

    def _is_wanted(self, stream: Stream) -> bool:
        runs = self._choices.runs(stream.name)
        if runs is not None:
            return runs
        tap = self._taps.get(stream.name)
        return self._has_subscriber(stream) or self._has_local(stream.name) or bool(tap and tap.busy)

    def _has_subscriber(self, stream: Stream) -> bool:
        return stream.direction is Direction.S2MM and self._wanted(stream.name)

    def _has_local(self, name: str) -> bool:
        return any(local.stream == name and not local.leaving for local in self._locals.values())

    def _may_run(self, name: str) -> bool:
        return name not in self._held and self._choices.runs(name) is not False and not self._silence.of(name)

    def _running(self, stream: Stream, first: Callable[[Pump], bool] = lambda _: True) -> Pump:
        if stream.name in self._held:
            raise StreamStopped(f"stream {stream.name!r} is stopped while its region changes")
        if self._silence.of(stream.name):
            raise Timeout(f"stream {stream.name!r}: the board does not answer; it goes on when the board does")
        if not self._may_run(stream.name):
            raise StreamStopped(f"stream {stream.name!r} was stopped; cm_data_config with enable lets it run")
        return self._pumps.get(stream.name) or self._open(stream, first)

    def _open(self, stream: Stream, first: Callable[[Pump], bool] = lambda _: True) -> Pump:
        """Open a stream; who is there already, and what `first` attaches, get it from its first frame on."""
        with self._silence.noticed(stream):
            pump = Pump(self._plane, self._devices.dma(stream.channel), stream)
        try:
            pump.label(self._config.name if self._config else "", self._mode or "")
            self._pumps[stream.name] = pump
            first(pump)
            for client, local in list(self._locals.items()):
                if local.stream == stream.name and not local.leaving:
                    self._attach_again(pump, client, local)
            self._refresh_tap(stream)
            pump.start()
        except BaseException:
            self._close(stream.name)
            raise
        return pump

    def _attach_again(self, pump: Pump, client: int, local: _Local) -> None:
        try:
            pump.attach(client, local.depth, local.peer)
        except (CmError, OSError) as error:
            self._plane.drop(client)
            self._on_error(ErrorInfo("no_slots", f"a client of {pump.stream.name!r} was hung up on: {error}"))

    def _open_quietly(self, stream: Stream) -> None:
        try:
            self._open(stream)
        except (CmError, OSError) as error:
            code = error.code if isinstance(error, CmError) else "device_error"
            self._on_error(ErrorInfo(code, f"stream {stream.name!r} cannot be opened: {error}"))

    def _refresh_tap(self, stream: Stream) -> None:
        """A tap for who listens over ZeroMQ, and none for nobody."""
        tap = self._taps.get(stream.name)
        if tap is None and self._has_subscriber(stream):
            self._read_tap(self._pumps[stream.name])
        elif tap is not None and not tap.busy and not self._has_subscriber(stream):
            self._taps.pop(stream.name).close()

    def _read_tap(self, pump: Pump) -> ReadTap:
        tap = self._taps.get(pump.stream.name)
        if not isinstance(tap, ReadTap):
            tap = self._taps[pump.stream.name] = ReadTap(self._loop, self._plane, pump, self._fan_out)
        return tap

    def _close(self, name: str, error: int = 0) -> None:
        tap = self._taps.pop(name, None)
        pump = self._pumps.pop(name, None)
        if pump is not None:
            pump.close(error)
        if tap is not None:
            tap.close()

    def _end_silently(self, name: str, error: int) -> None:
        """As `_close`, for a channel that does not answer: it is kept, and asked whether it does again."""
        tap, pump = self._taps.pop(name, None), self._pumps.pop(name)
        self._silence.begin(name, pump.release(error))
        if tap is not None:
            tap.close()

    def _hold(self, names: Collection[str]) -> None:
        self._held.update(names)
        for name in names:
            self._close(name)

    def _plane_event(self) -> None:
        while (event := self._plane.event()) is not None:
            if isinstance(event, ClientGone):
                self._client_gone(event.client)
            elif isinstance(event, ClientLeaves):
                self._client_leaves(event.client)
            else:
                self._lost(event.stream, event.error)

    def _client_leaves(self, client: int) -> None:
        """What it holds stays its own, but nothing runs for it any more."""
        if client in self._locals:
            self._locals[client] = replace(self._locals[client], leaving=True)
            self.refresh()

    def _client_gone(self, client: int) -> None:
        self.echoes.gone(client)
        local = self._locals.pop(client, None)
        if local is not None and local.stream in self._pumps:
            self._pumps[local.stream].detached(client)
        self.refresh()

    def _lost(self, number: int, error: int) -> None:
        for name, pump in list(self._pumps.items()):
            if pump.id == number:
                text = os.strerror(error)
                _LOG.warning("stream %s ended: %s", name, text)
                if error == errno.ETIMEDOUT:
                    self._end_silently(name, error)
                else:
                    self._close(name, error)
                self._on_error(ErrorInfo("device_error", f"stream {name!r} ended: {text}"))

    def _fan_out(self, frame: Frame) -> None:
        for sink in self._sinks:
            sink.frame(frame)
