# SPDX-License-Identifier: Apache-2.0
"""The asyncio client: `connect()` gives a `Board` whose methods are those of `cm.client.board`, awaited.

async with cm.aio.connect() as board:
    await board.load("camera", mode="default")
    await board.registers.write({"focus": 2})
    async for frame in board.stream("camera"):
        ...
"""

from __future__ import annotations

import asyncio
import itertools
import os
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import zmq
import zmq.asyncio

from cm.client import calls
from cm.client.address import Keys, load_keys, resolve
from cm.client.aio_memory import Memories, Memory
from cm.client.aio_stream import (
    AsyncLocalStream,
    AsyncNewestStream,
    AsyncRemoteStream,
    AsyncWriter,
    Stream,
    receive,
)
from cm.client.calls import Call
from cm.client.errors import NoAnswer
from cm.client.frame import Frame
from cm.client.link import prepare
from cm.client.zmq_frames import Wanted
from cm.errors import InvalidRequest
from cm.messages.requests import ConfigureStream, DefineMemory, ReleaseLease, TakeLease
from cm.messages.status import ConfigInfo, FrameInfo, Irq, LeaseInfo, PlanInfo, Progress, Status, StreamStatus
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
    """A board, to be entered with ``async with``; arguments and errors as in `cm.connect`."""
    return Board(endpoint, runtime_dir=runtime_dir, timeout=timeout, keys=keys)


class Board:
    """A board behind a configuration manager. One event loop; several requests may be under way."""

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        runtime_dir: str | os.PathLike[str] | None = None,
        timeout: float = 5.0,
        keys: str | os.PathLike[str] | Keys | None = None,
    ) -> None:
        self._endpoints = resolve(endpoint, runtime_dir)
        self._keys = keys if keys is None or isinstance(keys, Keys) else load_keys(keys)
        folder = Path(self._endpoints.req.removeprefix("ipc://")).parent
        local = self._endpoints.req.startswith("ipc://")
        self._data = folder if local and (folder / packets.SOCKET).exists() else None
        self._timeout = timeout
        self._context = zmq.asyncio.Context()
        self._numbers = itertools.count(1)
        self._pending: dict[bytes, asyncio.Future[list[bytes]]] = {}
        self._socket: zmq.asyncio.Socket | None = None
        self._reader: asyncio.Task[None] | None = None
        self.registers = Registers(self)
        self.interrupts = Interrupts(self)
        self.memories = Memories(self.ask, self.config)

    async def __aenter__(self) -> Board:
        self._socket = self._context.socket(zmq.DEALER)
        prepare(self._socket, self._keys)
        self._socket.connect(self._endpoints.req)
        self._reader = asyncio.create_task(self._read())
        try:
            await self.status()
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect; twice is fine."""
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.gather(self._reader, return_exceptions=True)
            self._reader = None
        self._context.destroy(linger=0)

    async def _read(self) -> None:
        assert self._socket is not None
        while True:
            frames = await self._socket.recv_multipart()
            waiting = self._pending.pop(frames[0], None)
            if waiting is not None and not waiting.done():
                waiting.set_result(frames[2:])

    async def ask(self, call: Call[_T], timeout: float | None = 0.0) -> _T:
        """Make a call. `timeout` in seconds; None waits for ever, 0 as long as `connect` said."""
        assert self._socket is not None, "enter the board first: async with cm.aio.connect() as board"
        number = b"%d" % next(self._numbers)
        waiting: asyncio.Future[list[bytes]] = asyncio.get_running_loop().create_future()
        self._pending[number] = waiting
        limit = self._timeout if timeout == 0.0 else timeout
        try:
            await self._socket.send_multipart([number, b"", *encode_request(call.request)])
            frames = await asyncio.wait_for(waiting, limit)
        except asyncio.TimeoutError:
            where = self._endpoints.req
            raise NoAnswer(f"no answer from a configuration manager at {where} within {limit:g} s") from None
        finally:
            self._pending.pop(number, None)
        return call.result(decode_reply(frames))

    def subscribe(self, *names: bytes, depth: int = 0) -> zmq.asyncio.Socket:
        """A SUB socket on topics, on which `depth` messages wait (0: ZeroMQ's own number); the caller closes it."""
        socket = self._context.socket(zmq.SUB)
        prepare(socket, self._keys, depth)
        for name in names:
            socket.setsockopt(zmq.SUBSCRIBE, name)
        socket.connect(self._endpoints.pub)
        return socket

    async def status(self) -> Status:
        """The state of the PL now."""
        return await self.ask(calls.status())

    async def watch(self, timeout: float | None = None) -> AsyncIterator[Status]:
        """Every status from now on, the current one first."""
        socket = self.subscribe(topics.STATUS)
        try:
            while True:
                yield await _next_event(socket, timeout, Status)
        finally:
            socket.close()

    async def configs(self) -> tuple[str, ...]:
        """Names of the configurations that can be loaded."""
        return await self.ask(calls.config_names())

    async def config(self, name: str = "") -> ConfigInfo:
        """A configuration; the loaded one's if no name is given."""
        return await self.ask(calls.describe(name))

    async def load(
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
        """Go to a mode and wait until the board is there; returns the seconds it took."""
        call = calls.load(config, mode, wait=True, queue=queue, force=force, lease=lease)
        teller = asyncio.create_task(self._tell(progress)) if progress else None
        try:
            return (await self.ask(call, timeout)).seconds
        finally:
            if teller is not None:
                teller.cancel()
                await asyncio.gather(teller, return_exceptions=True)

    async def _tell(self, progress: Callable[[Progress], None]) -> None:
        async for status in self.watch():
            if status.progress is not None:
                progress(status.progress)

    async def set_mode(self, mode: str) -> float:
        """Go to a mode of the loaded configuration."""
        return await self.load(mode=mode)

    async def cancel(self) -> None:
        """Cancel the running change before its next load; the board goes back."""
        await self.ask(calls.cancel())

    async def plan(self, mode: str = "", config: str = "") -> PlanInfo:
        """What going to a mode would do; touches nothing."""
        return await self.ask(calls.plan(mode, config), timeout=30.0)

    async def provision(self, schema: str | os.PathLike[str], *files: str | os.PathLike[str]) -> ConfigInfo:
        """Send a schema file with the bitstreams and overlays that belong to it."""
        return await self.ask(calls.provision(Path(schema), tuple(map(Path, files)), ""), timeout=60.0)

    async def take_lease(self, scope: str = "board", *, exclusive: bool = True, seconds: float = 30.0) -> LeaseInfo:
        """Hold part of the board for some seconds; give it back with `return_lease`."""
        pid = os.getpid() if self._endpoints.req.startswith("ipc://") else 0
        return await self.ask(calls.lease(TakeLease(scope, exclusive, seconds, holder=f"pid {os.getpid()}", pid=pid)))

    async def return_lease(self, lease: LeaseInfo) -> None:
        """Give a lease back."""
        await self.ask(calls.lease(ReleaseLease(lease.id)))

    async def read(self, stream: str = "", timeout: float = 1.0) -> Frame:
        """The next frame of a stream."""
        return await self.ask(calls.read_data(stream, timeout), timeout=timeout + self._timeout)

    async def write(self, stream: str, data: Any, lease: str = "") -> FrameInfo:
        """Send an array or bytes to the hardware; returns when it has taken them."""
        return await self.ask(calls.write_data(stream, data, lease), timeout=self._timeout + 5.0)

    async def configure_stream(self, stream: str, **settings: Any) -> StreamStatus:
        """Set properties of a stream (`cm.messages.requests.ConfigureStream`)."""
        return await self.ask(calls.configure_stream(ConfigureStream(stream, **settings)))

    async def configure_memory(
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
        await self.ask(calls.define_memory(request))
        return Memory(self.ask, name)

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
        """The frames of a stream (``async for``), without copies on the manager's machine; see `cm.client.board`."""
        if self._data is not None:
            return AsyncLocalStream(self._data, Open(name, depth=depth, lease=lease), timeout, newest)
        wanted = Wanted(name, timeout, newest, compression, depth)
        return AsyncNewestStream(self.ask, wanted) if newest else AsyncRemoteStream(self.ask, self.subscribe, wanted)

    def writer(self, name: str, timeout: float | None = 5.0, *, depth: int = 0, lease: str = "") -> AsyncWriter:
        """Write a stream without copies: ``async with writer.slot() as array: array[...] = frame``."""
        return AsyncWriter(self._local_data("a writer"), Open(name, write=True, depth=depth, lease=lease), timeout)

    def echo(self, length: int, timeout: float | None = 5.0, *, depth: int = 2) -> AsyncWriter:
        """Slots of `length` bytes that need no hardware: what is sent is done at once. For measuring."""
        return AsyncWriter(self._local_data("an echo"), Open("", depth=depth, echo=True, length=length), timeout)

    def _local_data(self, what: str) -> Path:
        if self._data is None:
            raise InvalidRequest(f"{what} needs the manager's data socket, which only its own machine has")
        return self._data


class Registers:
    """Registers and fields of the current mode by name."""

    def __init__(self, board: Board) -> None:
        self._board = board

    async def read(self, *names: str) -> dict[str, int]:
        """Values by name; all that can be read if none is named."""
        return {v.name: v.value for v in (await self._board.ask(calls.read_registers(names))).values}

    async def write(self, values: dict[str, int], lease: str = "") -> dict[str, int]:
        """Several in order, all checked before the first is written; returns what they hold then."""
        return {v.name: v.value for v in (await self._board.ask(calls.write_registers(values, lease))).values}

    async def write_masked(self, name: str, value: int, mask: int, lease: str = "") -> int:
        """Only the bits in `mask`; returns the register's value."""
        return (await self._board.ask(calls.write_masked(name, value, mask, lease))).values[0].value


class Interrupts:
    """Interrupts of the loaded configuration by name."""

    def __init__(self, board: Board) -> None:
        self._board = board

    async def count(self, name: str) -> int:
        """How often one came since the configuration was loaded."""
        return (await self._board.ask(calls.interrupt(name))).count

    async def wait(self, name: str, timeout: float | None = None) -> Irq:
        """Wait for the next one. Raises Timeout."""
        events = self.events(name, timeout)
        try:
            return await events.__anext__()
        finally:
            await events.aclose()

    async def events(self, name: str, timeout: float | None = None) -> AsyncGenerator[Irq, None]:
        """Each one from now on."""
        socket = self._board.subscribe(topics.IRQ)
        try:
            start = await self.count(name)
            while True:
                irq = await _next_event(socket, timeout, Irq)
                if irq.name == name and irq.count > start:
                    yield irq
        finally:
            socket.close()


async def _next_event(socket: zmq.asyncio.Socket, timeout: float | None, kind: type[_T]) -> _T:
    while True:
        event = decode_event(await receive(socket, timeout))
        if isinstance(event, kind):
            return event
