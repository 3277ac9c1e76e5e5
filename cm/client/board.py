# SPDX-License-Identifier: Apache-2.0
"""The blocking client: `connect()` gives a `Board`."""

from __future__ import annotations

import os
import time
import weakref
from collections.abc import Callable, Iterator, MutableMapping
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import zmq

from cm.client import calls
from cm.client.address import Keys, load_keys, resolve
from cm.client.calls import Call
from cm.client.frame import Frame
from cm.client.lease import BoardLease
from cm.client.link import Link, Socket, prepare
from cm.client.memories import Memories, Memory
from cm.client.stream import LocalStream, NewestStream, RemoteStream, Stream, receive
from cm.client.writer import Writer
from cm.client.zmq_frames import Wanted
from cm.errors import InvalidRequest
from cm.messages.requests import ConfigureStream, DefineMemory
from cm.messages.status import (
    ConfigInfo,
    FrameInfo,
    Irq,
    PlanInfo,
    Progress,
    RegisterInfo,
    Status,
    StreamStatus,
)
from cm.wire import plane as packets
from cm.wire import topics
from cm.wire.encode import decode_event, decode_reply, encode_request
from cm.wire.plane import Open

_T = TypeVar("_T")


def connect(
    endpoint: str | None = None,
    *,
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout: float = 5.0,
    keys: str | os.PathLike[str] | Keys | None = None,
) -> Board:
    """Connect to a configuration manager and check that it answers.

    Args:
        endpoint: ``tcp://host[:port]`` or a runtime folder; default: the manager of this machine.
        runtime_dir: the runtime folder, spelt out.
        timeout: seconds to wait for answers to all but `load`.
        keys: a client's key file (``cm keygen``), or the keys.

    Raises NotFound where nobody serves, NoAnswer where nobody answers.
    """
    board = Board(endpoint, runtime_dir=runtime_dir, timeout=timeout, keys=keys)
    try:
        _ = board.status
    except BaseException:
        board.close()
        raise
    return board


class Board:
    """A board behind a configuration manager. Use as a context manager. Threads may share it."""

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        runtime_dir: str | os.PathLike[str] | None = None,
        timeout: float = 5.0,
        keys: str | os.PathLike[str] | Keys | None = None,
    ) -> None:
        self._endpoints = resolve(endpoint, runtime_dir)
        self._local = self._endpoints.req.startswith("ipc://")
        folder = Path(self._endpoints.req.removeprefix("ipc://")).parent
        self._data = folder if self._local and (folder / packets.SOCKET).exists() else None
        self._keys = keys if keys is None or isinstance(keys, Keys) else load_keys(keys)
        self.timeout = timeout
        self._context: zmq.Context[Socket] = zmq.Context()
        self._link = self._new_link()
        self.registers = Registers(self)
        self.interrupts = Interrupts(self)
        self.memories = Memories(self.ask, self.config)

    # ---- asking ---------------------------------------------------------------------

    def ask(self, call: Call[_T], timeout: float | None = None) -> _T:
        """Make a call and return its result. Raises what `cm.client.errors` holds."""
        frames = self._link.ask(encode_request(call.request), timeout or self.timeout)
        return call.result(decode_reply(frames))

    def subscribe(self, *topic: bytes, depth: int = 0) -> Socket:
        """A SUB socket on topics, on which `depth` messages wait (0: ZeroMQ's own number); the caller closes it."""
        socket = prepare(self._context.socket(zmq.SUB), self._keys, depth)
        for name in topic:
            socket.setsockopt(zmq.SUBSCRIBE, name)
        socket.connect(self._endpoints.pub)
        return socket

    # ---- status -----------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """The state of the PL now."""
        return self.ask(calls.status())

    def watch(self, timeout: float | None = None) -> Iterator[Status]:
        """Every status from now on, the current one first. Raises Timeout if none comes for `timeout` seconds."""
        with self.subscribe(topics.STATUS) as socket:
            while True:
                yield _next_event(socket, timeout, Status)

    # ---- configurations -----------------------------------------------------------------

    @property
    def configs(self) -> tuple[str, ...]:
        """Names of the configurations that can be loaded."""
        return self.ask(calls.config_names())

    def config(self, name: str = "") -> ConfigInfo:
        """A configuration's modes, registers, streams and interrupts; the loaded one's if no name is given."""
        return self.ask(calls.describe(name))

    def load(
        self,
        config: str = "",
        mode: str = "",
        *,
        progress: Callable[[Progress], None] | None = None,
        timeout: float | None = None,
        queue: bool = True,
        force: bool = False,
        lease: str = "",
    ) -> float:
        """Go to a mode of a configuration and wait until the board is there; returns the seconds it took.

        Raises RequestFailed (the board is then where the sentence says), ConnectionLost, NoAnswer.
        """
        call = calls.load(config, mode, wait=True, queue=queue, force=force, lease=lease)
        if progress is None:
            return call.result(decode_reply(self._link.ask(encode_request(call.request), timeout))).seconds
        with self.subscribe(topics.STATUS) as socket:
            tell = _Progress(socket, progress)
            frames = self._link.ask(encode_request(call.request), timeout, socket, tell)
            return call.result(decode_reply(frames)).seconds

    def load_async(
        self, config: str = "", mode: str = "", *, queue: bool = True, force: bool = False, lease: str = ""
    ) -> ChangeHandle:
        """Ask for a mode and return at once; the handle says when the board is there."""
        watcher = self.subscribe(topics.STATUS)
        try:
            info = self.ask(calls.load(config, mode, wait=False, queue=queue, force=force, lease=lease))
        except BaseException:
            watcher.close()
            raise
        return ChangeHandle(self, info.number, watcher)

    @property
    def mode(self) -> str:
        """The mode the board is in; setting it goes there and waits."""
        return self.status.mode

    @mode.setter
    def mode(self, mode: str) -> None:
        self.load(mode=mode)

    def plan(self, mode: str = "", config: str = "") -> PlanInfo:
        """What going to a mode would do, and what it would cost; touches nothing."""
        return self.ask(calls.plan(mode, config), timeout=max(self.timeout, 30.0))

    def provision(self, schema: str | os.PathLike[str], *files: str | os.PathLike[str], lease: str = "") -> ConfigInfo:
        """Send a schema file with the bitstreams and overlays that belong to it; it can then be loaded."""
        call = calls.provision(Path(schema), tuple(map(Path, files)), lease)
        return self.ask(call, timeout=max(self.timeout, 60.0))

    def lease(
        self, scope: str = "board", *, exclusive: bool = True, seconds: float = 30.0, holder: str = ""
    ) -> BoardLease:
        """Hold ``board``, ``config``, ``region:NAME`` or ``registers:NAME``, as a context manager."""
        return BoardLease(self.ask, scope, exclusive, seconds, holder or f"pid {os.getpid()}", self._local)

    # ---- data -----------------------------------------------------------------------------

    def stream(
        self,
        name: str,
        timeout: float | None = 5.0,
        *,
        depth: int = 0,
        newest: bool = False,
        compression: str = "",
        lease: str = "",
    ) -> Stream:
        """The frames of a stream, as a context manager and iterator; frames lost to slowness show in `sequence`.

        On the manager's machine frames are not copied: arrays lie in DMA memory, `depth` of them (0: 4) may be
        held at a time, and go back when the last reference to them goes. `newest` skips those that wait behind
        a newer one. From elsewhere they come over ZeroMQ: `compression` "lz4" makes them smaller (it needs the
        package lz4 at both ends), `newest` asks for each frame when it is read, and `depth` of them (0: 4) wait
        here, beside those at the manager. `timeout` in seconds, None waits
        for ever. `lease`: the id of one's own, where a stream with back-pressure lies in a region that is held.
        """
        if self._data is not None:
            return LocalStream(self._data, Open(name, depth=depth, lease=lease), timeout, newest)
        wanted = Wanted(name, timeout, newest, compression, depth)
        return NewestStream(self._new_link, wanted) if newest else RemoteStream(self, wanted)

    def _new_link(self) -> Link:
        return Link(self._context, self._endpoints.req, self._keys)

    def writer(self, name: str, timeout: float | None = 5.0, *, depth: int = 0, lease: str = "") -> Writer:
        """Write a stream without copies: ``with writer.slot() as array: array[...] = frame``.

        `depth` slots (0: 4) are ours. On the manager's machine only; `write` works from anywhere.
        `lease`: the id of one's own, where the stream's region is held.
        """
        return Writer(self._local_data("a writer"), Open(name, write=True, depth=depth, lease=lease), timeout)

    def echo(self, length: int, timeout: float | None = 5.0, *, depth: int = 2) -> Writer:
        """Slots of `length` bytes that need no hardware: what is sent is done at once. For measuring."""
        return Writer(self._local_data("an echo"), Open("", depth=depth, echo=True, length=length), timeout)

    def _local_data(self, what: str) -> Path:
        if self._data is None:
            raise InvalidRequest(f"{what} needs the manager's data socket, which only its own machine has")
        return self._data

    def read(self, stream: str = "", timeout: float = 1.0) -> Frame:
        """The next frame of a stream."""
        return self.ask(calls.read_data(stream, timeout), timeout=timeout + self.timeout)

    def write(self, stream: str, data: Any, lease: str = "") -> FrameInfo:
        """Send an array or bytes to the hardware; returns when it has taken them."""
        return self.ask(calls.write_data(stream, data, lease), timeout=self.timeout + 5.0)

    def configure_stream(self, stream: str, **settings: Any) -> StreamStatus:
        """Set shape, dtype, slots, rate, stride, cyclic, backpressure, enable of a stream; what is left out stays.

        `cm.messages.requests.ConfigureStream` has them all. Raises RequestBusy while it is in use, without `force`,
        and InvalidRequest for what cannot be: then nothing has changed.
        """
        return self.ask(calls.configure_stream(ConfigureStream(stream, **settings)))

    def configure_memory(
        self,
        name: str,
        address: int,
        length: int,
        *,
        shape: tuple[int, ...] = (),
        dtype: str = "",
        access: str = "",
        region: str = "",
        lease: str = "",
    ) -> Memory:
        """Name `length` bytes at a physical address, until another configuration is loaded.

        They must lie in the window of a UIO device. `access`: "rw" (default), "ro" or "wo"; who may write must
        not cover what has a name. `region`: whose module answers there, or "static"; it need not be said where
        all else that has a name in that window is in one. Raises RequestFailed.
        """
        request = DefineMemory(name, address, length, shape, dtype, access, region, lease)
        self.ask(calls.define_memory(request))
        return Memory(self.ask, name)

    # ---- life -----------------------------------------------------------------------------

    def close(self) -> None:
        """Disconnect; twice is fine."""
        self._link.close()
        self._context.destroy(linger=0)

    def __enter__(self) -> Board:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


class Registers(MutableMapping[str, int]):
    """Registers (``"focus"``) and fields (``"control.enable"``) of the current mode by name."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def __getitem__(self, name: str) -> int:
        return self._board.ask(calls.read_registers((name,))).values[0].value

    def __setitem__(self, name: str, value: int) -> None:
        self.write({name: value})

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register cannot be deleted")

    def __iter__(self) -> Iterator[str]:
        """Names of all that can be read now."""
        return iter(self.read())

    def __len__(self) -> int:
        return len(self.read())

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.partition(".")[0] in self.info

    @property
    def info(self) -> dict[str, RegisterInfo]:
        """What the schema says of each register that the current mode has."""
        config = self._board.config()
        return {r.name: r for r in config.registers if not r.modes or config.mode in r.modes}

    def read(self, *names: str) -> dict[str, int]:
        """Several at once; all that can be read if none is named."""
        return {v.name: v.value for v in self._board.ask(calls.read_registers(names)).values}

    def write(self, values: dict[str, int], lease: str = "") -> dict[str, int]:
        """Several in order, all checked before the first is written; returns what they hold then."""
        return {v.name: v.value for v in self._board.ask(calls.write_registers(values, lease)).values}

    def write_masked(self, name: str, value: int, mask: int, lease: str = "") -> int:
        """Only the bits in `mask`; returns the register's value."""
        return self._board.ask(calls.write_masked(name, value, mask, lease)).values[0].value


class Interrupts:
    """Interrupts of the loaded configuration by name."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def __getitem__(self, name: str) -> Interrupt:
        return Interrupt(self._board, name)

    def __iter__(self) -> Iterator[str]:
        return (i.name for i in self._board.config().interrupts)


class Interrupt:
    """One interrupt."""

    def __init__(self, board: Board, name: str) -> None:
        self._board = board
        self.name = name

    @property
    def count(self) -> int:
        """How often it came since the configuration was loaded."""
        return self._board.ask(calls.interrupt(self.name)).count

    def wait(self, timeout: float | None = None) -> Irq:
        """Wait for the next one. Raises Timeout."""
        return next(self.events(timeout))

    def events(self, timeout: float | None = None) -> Iterator[Irq]:
        """Each one from now on. Raises Timeout if none comes for `timeout` seconds."""
        with self._board.subscribe(topics.IRQ, topics.STATUS) as socket:
            _next_event(socket, self._board.timeout, Status)  # from here on the subscription holds
            socket.setsockopt(zmq.UNSUBSCRIBE, topics.STATUS)
            start = self._board.ask(calls.interrupt(self.name)).count
            while True:
                yield _next_event(socket, timeout, Irq, lambda e: e.name == self.name and e.count > start)


class ChangeHandle:
    """A change under way. The change goes on where the handle is dropped."""

    def __init__(self, board: Board, number: int, watcher: Socket) -> None:
        self._board = board
        self.number = number
        self._watcher = watcher
        # Who asks and never looks leaves no socket behind, which the board's context would wait for at its end.
        self._close = weakref.finalize(self, watcher.close)
        self.progress: Progress | None = None
        self._ended: Status | None = None

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        while self._ended is None and self._watcher.poll(0):
            self._take(_next_event(self._watcher, 0, Status))
        return self._ended is not None

    def wait(self, timeout: float | None = None) -> float:
        """Wait for its end; returns its seconds. Raises RequestFailed, Timeout."""
        while self._ended is None:
            self._take(_next_event(self._watcher, timeout, Status))
        self._close()
        return calls.ended(self._ended, self.number)

    def cancel(self) -> None:
        """Cancel it before its next load; the board goes back."""
        self._board.ask(calls.cancel())

    def _take(self, status: Status) -> None:
        self.progress = status.progress
        if status.last_change >= self.number:
            self._ended = status


class _Progress:
    """Hands progress of statuses to a callback."""

    def __init__(self, socket: Socket, tell: Callable[[Progress], None]) -> None:
        self._socket = socket
        self._tell = tell

    def __call__(self) -> None:
        event = decode_event(self._socket.recv_multipart())
        if isinstance(event, Status) and event.progress is not None:
            self._tell(event.progress)


def _next_event(
    socket: Socket, timeout: float | None, kind: type[_T], wanted: Callable[[_T], bool] = lambda _: True
) -> _T:
    """The next event of a kind; others do not prolong the time-out."""
    until = None if timeout is None else time.monotonic() + timeout
    while True:
        left = None if until is None else max(0.0, until - time.monotonic())
        event = decode_event(receive(socket, left))
        if isinstance(event, kind) and wanted(event):
            return event
