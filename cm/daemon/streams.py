# SPDX-License-Identifier: Apache-2.0
"""The streams of the loaded mode: opened when somebody wants them, stopped while their region changes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Protocol

from cm.daemon.devices import BoardDevices
from cm.daemon.loop import Loop
from cm.daemon.pump import Frame, Pump, ReadPump, WritePump
from cm.errors import Busy, CmError, InvalidRequest
from cm.manager.describe import stream_status
from cm.manager.errors import NothingLoaded, UnknownStream
from cm.manager.resolve import hint
from cm.messages.requests import DataConfig
from cm.messages.status import ErrorInfo, StreamStatus
from cm.schema.model import Config, Direction, Stream

_LOG = logging.getLogger(__name__)
_MAX_FRAME = 1 << 30


class Sink(Protocol):
    """Takes frames; the frame's memory is valid during the call only."""

    def frame(self, frame: Frame) -> None:
        """A frame came."""


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
        self._overrides: dict[str, DataConfig] = {}
        self._pumps: dict[str, Pump] = {}
        self._wanted: Callable[[str], bool] = lambda _: False
        self._enabled: dict[str, bool] = {}

    # ---- wiring -------------------------------------------------------------------

    def add_sink(self, sink: Sink) -> None:
        """Frames of all streams go to every sink."""
        self._sinks.append(sink)

    def wanted_by(self, wanted: Callable[[str], bool]) -> None:
        """Who says whether somebody listens to a stream."""
        self._wanted = wanted

    # ---- DataPlane: called by the worker ----------------------------------------------

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop streams; their transfers have ended when this returns."""
        self._loop.ask(lambda: self._close_all(streams))

    def resume(self, config: Config | None, mode: str | None) -> None:
        """The streams are those of this mode."""
        self._loop.ask(lambda: self._enter(config, mode))

    # ---- requests: the loop's thread ----------------------------------------------------

    def refresh(self) -> None:
        """Open what is wanted, close what nobody wants any more."""
        for name, stream in self._streams.items():
            wanted = self._is_wanted(stream)
            if wanted and name not in self._pumps:
                self._open_quietly(stream)
            elif not wanted and name in self._pumps:
                self._close(name)

    def configure(self, request: DataConfig) -> StreamStatus:
        """Change a stream; refused while it is in use unless forced. Raises UnknownStream, InvalidRequest, Busy."""
        stream = self.named(request.stream, None)
        changed = _changed(stream, request)
        if changed != stream and self._pumps.get(stream.name) and self._is_wanted(stream) and not request.force:
            raise Busy(f"stream {stream.name!r} is in use; close its readers, or force the change")
        if changed != stream:
            self._close(stream.name)
            self._overrides[stream.name] = request
            self._streams[stream.name] = changed
        if request.enable is not None:
            self._enabled[stream.name] = request.enable
        if self._is_wanted(changed) and stream.name not in self._pumps:
            self._open(changed)
        self.refresh()
        return self.status_of(stream.name)

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

    def read_once(self, name: str, timeout: float, done: Callable[[Frame | CmError], None]) -> None:
        """Hand the next frame of a stream to `done`, or a Timeout."""
        stream = self.named(name, Direction.S2MM)
        pump = self._running(stream)
        assert isinstance(pump, ReadPump)
        pump.read_once(timeout or 1.0, done)

    def write(self, name: str, data: bytes | memoryview, done: Callable[[Frame | CmError], None]) -> None:
        """Send a frame; `done` is called when the hardware has taken it. Raises InvalidRequest, Busy."""
        stream = self.named(name, Direction.MM2S)
        pump = self._running(stream)
        assert isinstance(pump, WritePump)
        pump.write(data, done)

    def status(self) -> tuple[StreamStatus, ...]:
        """All streams of this mode."""
        return tuple(self.status_of(name) for name in self._streams)

    def status_of(self, name: str) -> StreamStatus:
        """One stream."""
        pump = self._pumps.get(name)
        return pump.status() if pump else stream_status(self._streams[name])

    @property
    def any_open(self) -> bool:
        """Whether any stream runs."""
        return bool(self._pumps)

    def close(self) -> None:
        """Stop all."""
        self._close_all(list(self._pumps))

    # ---- inner ----------------------------------------------------------------------

    def _enter(self, config: Config | None, mode: str | None) -> None:
        streams = dict(config.modes[mode].streams) if config and mode is not None and mode in config.modes else {}
        if config is not None and (self._config is None or config.name != self._config.name):
            self._overrides.clear()
            self._enabled.clear()
        same_mode = mode == self._mode
        self._config, self._mode = config, mode
        if not same_mode:
            self._overrides.clear()  # a mode's shapes are the schema's until somebody changes them again
        new = {n: _changed(s, self._overrides[n]) if n in self._overrides else s for n, s in streams.items()}
        for name in list(self._pumps):
            if new.get(name) != self._streams.get(name):
                self._close(name)
        self._streams = new
        for pump in self._pumps.values():
            pump.label(config.name if config else "", mode or "")
        self.refresh()

    def _is_wanted(self, stream: Stream) -> bool:
        enabled = self._enabled.get(stream.name)
        if enabled is not None:
            return enabled
        pump = self._pumps.get(stream.name)
        return (self._wanted(stream.name) and stream.direction is Direction.S2MM) or bool(pump and pump.busy)

    def _running(self, stream: Stream) -> Pump:
        return self._pumps.get(stream.name) or self._open(stream)

    def _open(self, stream: Stream) -> Pump:
        dma = self._devices.dma(stream.channel)
        kind = ReadPump if stream.direction is Direction.S2MM else WritePump
        try:
            pump = kind(self._loop, dma, stream, self._fan_out, self._lost)
        except BaseException:
            dma.close()
            raise
        pump.label(self._config.name if self._config else "", self._mode or "")
        self._pumps[stream.name] = pump
        return pump

    def _open_quietly(self, stream: Stream) -> None:
        try:
            self._open(stream)
        except (CmError, OSError) as error:
            code = error.code if isinstance(error, CmError) else "device_error"
            self._on_error(ErrorInfo(code, f"stream {stream.name!r} cannot be opened: {error}"))

    def _close(self, name: str) -> None:
        pump = self._pumps.pop(name, None)
        if pump is not None:
            pump.close()

    def _close_all(self, names: Collection[str]) -> None:
        for name in names:
            self._close(name)

    def _lost(self, name: str, error: Exception) -> None:
        _LOG.warning("stream %s ended: %s", name, error)
        self._close(name)
        code = error.code if isinstance(error, CmError) else "device_error"
        self._on_error(ErrorInfo(code, f"stream {name!r} ended: {error}"))

    def _fan_out(self, frame: Frame) -> None:
        for sink in self._sinks:
            sink.frame(frame)


def _changed(stream: Stream, request: DataConfig) -> Stream:
    """A stream as a request wants it. Raises InvalidRequest with what would be right."""
    if request.direction and request.direction.lower() != stream.direction.value:
        raise InvalidRequest(f"stream {stream.name!r} is {stream.direction.value}, not {request.direction!r}")
    changed = replace(
        stream,
        shape=request.shape or stream.shape,
        dtype=request.dtype or stream.dtype,
        slots=request.slots or stream.slots,
        rate=request.rate or stream.rate,
        cyclic=request.cyclic or stream.cyclic,
    )
    if not 1 <= changed.slots <= 256:
        raise InvalidRequest(f"stream {stream.name!r}: {changed.slots} slots; 1 to 256 can be had")
    if frame_bytes(changed) > _MAX_FRAME:
        raise InvalidRequest(f"stream {stream.name!r}: a frame of shape {changed.shape} has more than 1 GiB")
    return changed


def frame_bytes(stream: Stream) -> int:
    """Bytes of one frame; 0 where the schema gives no shape. Raises InvalidRequest for an unknown dtype."""
    import numpy as np

    if stream.shape is None:
        return 0
    try:
        size = np.dtype(stream.dtype).itemsize
    except TypeError as error:
        raise InvalidRequest(f"stream {stream.name!r}: {stream.dtype!r} is no numpy dtype such as 'uint8'") from error
    for extent in stream.shape:
        size *= extent
    return size
