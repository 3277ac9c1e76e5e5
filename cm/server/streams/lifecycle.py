# SPDX-License-Identifier: Apache-2.0
"""When the streams of the loaded mode run: who uses them, and what clients have set. No socket, no device.

`cm.server.streams.running` carries out what is decided here, and reports the outcome.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from cm.errors import Busy, InvalidRequest, Timeout
from cm.manager.errors import NothingLoaded, UnknownStream, hint
from cm.schema.model import Config, Direction, Stream
from cm.server.streams.machine import OPEN_PHASES, StreamEvent, StreamMachine, StreamPhase
from cm.wire.messages.requests import ConfigureStream


class StreamStopped(Busy):
    """The stream was stopped (its region is being changed) before the transfer ended."""

    code = "stream_stopped"


_P, _E, _NOTHING = StreamPhase, StreamEvent, MappingProxyType[str, str | None]({})


_AFTER_A_CHANGE = ((_P.HELD, _E.RELEASE), (_P.RESTING, _E.RETRY))
_REST = 0.9  # seconds after which a stream that could not be opened is due again; we are asked once a second
_SILENT = 10.0  # the same where its channel did not answer, as on a stopped simulated board: each try waits for it


class StreamLifecycle:
    """The streams of the loaded mode, their machines, and what clients have set.

    Settings last until the mode changes; whether a stream is enabled, until another configuration loads.
    """

    def __init__(self) -> None:
        self.config: Config | None = None
        self.mode: str | None = None
        self.streams: Mapping[str, Stream] = {}
        self._set: dict[str, tuple[Stream, Stream]] = {}  # as the schema has it, and as it was set
        self._runs: dict[str, bool] = {}  # whether it shall run even if unused, where a client has said
        self.machines: dict[str, StreamMachine] = {}  # also of streams of other modes, for which clients wait

    def machine(self, name: str) -> StreamMachine:
        """Return a stream's machine, whether or not this mode has the stream."""
        found = self.machines.get(name)
        if found is None:
            found = self.machines[name] = StreamMachine(name)
        return found

    def enter(self, config: Config | None, mode: str | None, held: Mapping[str, str | None] = _NOTHING) -> list[str]:
        """Switch to the streams of this mode, none of them held; return the open ones that have to be closed for it."""
        streams = config.streams_in(mode, held) if config else {}
        if config is not None and (self.config is None or config.name != self.config.name):
            self._set, self._runs = {}, {}  # streams of the same name are now different ones
        if mode != self.mode:
            self._set, self._runs = {}, {name: True for name, runs in self._runs.items() if runs}
        self._set = {n: found for n, found in self._set.items() if n not in streams or found[0] == streams[n]}
        before, self.streams = self.streams, {n: self._set[n][1] if n in self._set else s for n, s in streams.items()}
        self.config, self.mode = config, mode
        for phase, event in _AFTER_A_CHANGE:
            for name in self._in(phase):
                self.machines[name].after(event)
        return [name for name in self._in(*OPEN_PHASES) if self.streams.get(name) != before.get(name)]

    def _in(self, *phases: StreamPhase) -> list[str]:
        return [name for name, machine in self.machines.items() if machine.phase in phases]

    def due(self, is_used: Callable[[Stream], bool]) -> Iterator[tuple[StreamEvent, Stream]]:
        """Yield the streams to open and to close now."""
        for name, stream in list(self.streams.items()):
            machine = self.machine(name)
            if machine.phase is _P.RESTING and time.monotonic() >= machine.rest_until:
                machine.after(_E.RETRY)
            wanted = self.is_wanted(stream, is_used(stream))
            if machine.phase is _P.CLOSED and wanted:
                yield _E.OPEN, stream
            elif machine.phase in OPEN_PHASES and not wanted:
                yield _E.CLOSE, stream

    def rest(self, name: str, silent: bool = False) -> None:
        """A stream could not be opened: it is due again after a while, or in another mode, and not at its closing."""
        machine = self.machine(name)
        machine.silent, machine.rest_until = silent, time.monotonic() + (_SILENT if silent else _REST)

    def is_wanted(self, stream: Stream, used: bool) -> bool:
        """Whether a stream shall run if it can."""
        return self._runs.get(stream.name, used)

    def is_held(self, name: str) -> bool:
        """Whether a stream is stopped while its region changes."""
        return self.machine(name).phase is _P.HELD

    def is_silent(self, name: str) -> bool:
        """Whether a stream's channel did not answer a while ago."""
        machine = self.machine(name)
        return machine.phase is _P.RESTING and machine.silent and time.monotonic() < machine.rest_until

    def may_run(self, name: str) -> bool:
        """Whether a stream can be opened for a client."""
        return not (self.is_held(name) or self.is_silent(name)) and self._runs.get(name) is not False

    def check_may_run(self, name: str) -> None:
        """Raise StreamStopped or Timeout, with the reason, if it cannot."""
        if self.is_held(name):
            raise StreamStopped(f"stream {name!r} is stopped while its region changes")
        if self.is_silent(name):
            raise Timeout(f"stream {name!r}: the board does not answer; the stream resumes when it does")
        if self._runs.get(name) is False:
            raise StreamStopped(f"stream {name!r} was stopped; cm_data_config with enable lets it run")

    def set_to_run(self, name: str) -> bool:
        """Whether a client has set a stream to run even if unused."""
        return self._runs.get(name, False)

    def override(self, stream: Stream, wanted: Stream, request: ConfigureStream) -> Callable[[], None]:
        """Replace a stream by `wanted` from here on; return a function that undoes it."""
        name, held, runs = stream.name, self._set.copy(), self._runs.copy()
        self.streams = {**self.streams, name: wanted}
        if wanted != stream:
            self._set[name] = (self._set[name][0] if name in self._set else stream), wanted
        if request.automatic:
            self._runs.pop(name, None)
        elif request.enable is not None:
            self._runs[name] = request.enable

        def take_back() -> None:
            if self.streams.get(name) is wanted:  # it has not been changed again since
                self._set.pop(name, None)
                self._runs.pop(name, None)
                self._set |= {k: v for k, v in held.items() if k == name}
                self._runs |= {k: v for k, v in runs.items() if k == name}
                self.streams = {**self.streams, name: stream}

        return take_back

    def named(self, name: str, direction: Direction | None) -> Stream:
        """A stream by name, or the only one of a direction. Raises UnknownStream, NothingLoaded, InvalidRequest."""
        if self.config is None:
            raise NothingLoaded("nothing is loaded, so there are no streams")
        if not name and direction is not None:
            fitting = [s for s in self.streams.values() if s.direction is direction]
            if len(fitting) == 1:
                return fitting[0]
            names = ", ".join(s.name for s in fitting) or "none"
            raise UnknownStream(f"name a stream; {direction.value} streams of this mode are {names}")
        stream = self.streams.get(name)
        if stream is None:
            where = f"in mode {self.mode!r}" if self.mode else f"while {self.config.name} is in no mode"
            raise UnknownStream(f"no stream {name!r} {where}{hint(name, self.streams)}")
        if direction is not None and stream.direction is not direction:
            raise InvalidRequest(f"stream {name!r} is {stream.direction.value}: it cannot be used the other way")
        return stream
