# SPDX-License-Identifier: Apache-2.0
"""Streams for asyncio: the twins of `cm.client.stream` and `cm.client.writer`."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy.typing as npt
import zmq
import zmq.asyncio

from cm.client import calls
from cm.client.errors import RequestFailed
from cm.client.frame import Frame
from cm.client.link import STREAM_HWM
from cm.client.stream import LocalStream
from cm.client.writer import Writer
from cm.client.zmq_frames import ASK_FOR, STOPPED_PAUSE, Arrivals, Wanted, is_stopped
from cm.errors import Timeout
from cm.messages.requests import ConfigureStream
from cm.wire.plane import Open

Self = TypeVar("Self", bound="Stream")
Ask = Callable[..., Any]  # `cm.client.aio.Board.ask`


class Stream:
    """Frames of one stream: ``async for``, or ``await read()``; also an async context manager."""

    async def read(self, timeout: float | None = None) -> Frame:
        """The next frame. Raises Timeout."""
        raise NotImplementedError

    async def open(self) -> None:
        """Connect; `read` does it by itself."""
        raise NotImplementedError

    async def aclose(self) -> None:
        """Disconnect; twice is fine."""
        raise NotImplementedError

    @property
    def lost(self) -> int:
        """Frames that came while we were too slow."""
        raise NotImplementedError

    async def __aiter__(self) -> AsyncIterator[Frame]:
        try:
            while True:
                yield await self.read()
        finally:
            await self.aclose()

    async def __aenter__(self: Self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.aclose()


class AsyncLocalStream(Stream):
    """Frames in DMA memory; see `LocalStream`."""

    def __init__(self, folder: Path, wanted: Open, timeout: float | None, newest: bool = False) -> None:
        self._stream = LocalStream(folder, wanted, timeout, newest)
        self._timeout = timeout

    async def open(self) -> None:
        await asyncio.get_running_loop().run_in_executor(None, self._stream.open)

    @property
    def lost(self) -> int:
        return self._stream.lost

    async def read(self, timeout: float | None = None) -> Frame:
        if not self._stream.is_open:
            await self.open()
        limit = self._timeout if timeout is None else timeout
        try:
            return await asyncio.wait_for(self._next(), limit)
        except asyncio.TimeoutError:
            raise Timeout(self._stream.nothing(limit)) from None

    async def _next(self) -> Frame:
        while (frame := self._stream.poll()) is None:
            await _readable(self._stream.fileno())
        return frame

    async def aclose(self) -> None:
        self._stream.close()


class AsyncRemoteStream(Stream):
    """Frames over ZeroMQ; see `RemoteStream`."""

    def __init__(self, ask: Ask, subscribe: Callable[..., zmq.asyncio.Socket], wanted: Wanted) -> None:
        self._ask, self._subscribe, self._wanted = ask, subscribe, wanted
        self._socket: zmq.asyncio.Socket | None = None
        self._arrivals = Arrivals()

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    async def open(self) -> None:
        if self._socket is None:
            # raises for an unknown stream, and for what the manager cannot compress with
            await self._ask(
                calls.configure_stream(ConfigureStream(self._wanted.name, compression=self._wanted.compression))
            )
            self._socket = self._subscribe(self._wanted.topic, depth=self._wanted.depth or STREAM_HWM)

    async def read(self, timeout: float | None = None) -> Frame:
        await self.open()
        assert self._socket is not None
        return self._arrivals.frame(await receive(self._socket, self._wanted.timeout if timeout is None else timeout))

    async def aclose(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class AsyncNewestStream(Stream):
    """The next frame from when it is asked for, over ZeroMQ; see `NewestStream`."""

    def __init__(self, ask: Ask, wanted: Wanted) -> None:
        self._ask, self._wanted = ask, wanted
        self._arrivals = Arrivals()

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    async def open(self) -> None:
        await self._ask(calls.describe_stream(self._wanted.name))  # raises for an unknown stream

    async def read(self, timeout: float | None = None) -> Frame:
        limit = self._wanted.timeout if timeout is None else timeout
        until = None if limit is None else time.monotonic() + limit
        while True:
            left = ASK_FOR if until is None else min(ASK_FOR, until - time.monotonic())
            if left <= 0:
                raise Timeout(f"stream {self._wanted.name!r} gave no frame within {limit:g} s")
            try:
                return self._arrivals.count(await self._ask(calls.read_data(self._wanted.name, left), left + 5.0))
            except RequestFailed as error:
                if is_stopped(error):
                    await asyncio.sleep(min(STOPPED_PAUSE, left))
                elif not isinstance(error, Timeout):
                    raise

    async def aclose(self) -> None:
        """Nothing is open between two reads."""


class AsyncWriter:
    """Borrow slots, fill them, send them; see `Writer`. Entered with ``async with``."""

    def __init__(self, folder: Path, wanted: Open, timeout: float | None) -> None:
        self._folder, self._wanted, self._timeout = folder, wanted, timeout
        self._writer: Writer | None = None

    async def __aenter__(self) -> AsyncWriter:
        make = asyncio.get_running_loop().run_in_executor
        self._writer = await make(None, Writer, self._folder, self._wanted, self._timeout)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def _entered(self) -> Writer:
        assert self._writer is not None, "enter the writer first: async with board.writer(…) as writer"
        return self._writer

    @asynccontextmanager
    async def slot(self, length: int = 0) -> AsyncIterator[npt.NDArray[Any]]:
        """A free slot as an array to fill; it is sent when the block ends."""
        writer = self._entered()
        await self._until(lambda: writer.free > 0)
        with writer.slot(length) as array:
            yield array

    async def write(self, data: npt.ArrayLike) -> None:
        """Copy a frame into a slot and send it. Raises as `slot` does."""
        writer = self._entered()
        await self._until(lambda: writer.free > 0)
        writer.write(data)

    @property
    def under_way(self) -> int:
        """Frames that the hardware has not taken yet."""
        return self._entered().under_way

    async def flush(self) -> None:
        """Wait until the hardware has taken all frames. Raises Timeout, TransferFailed."""
        writer = self._entered()
        await self._until(lambda: writer.under_way == 0)
        writer.flush()

    async def _until(self, ready: Callable[[], bool]) -> None:
        writer = self._entered()

        async def wait() -> None:
            while not ready():
                if not writer.poll():
                    await _readable(writer.fileno())

        try:
            await asyncio.wait_for(wait(), self._timeout)
        except asyncio.TimeoutError:
            raise Timeout(
                f"stream {self._wanted.name!r}: the hardware took nothing within {self._timeout:g} s"
            ) from None


async def _readable(fd: int) -> None:
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[None] = loop.create_future()

    def wake() -> None:
        if not ready.done():
            ready.set_result(None)

    loop.add_reader(fd, wake)
    try:
        await ready
    finally:
        loop.remove_reader(fd)


async def receive(socket: zmq.asyncio.Socket, timeout: float | None) -> list[bytes]:
    """A message. Raises Timeout."""
    try:
        return await asyncio.wait_for(socket.recv_multipart(), timeout)
    except asyncio.TimeoutError:
        raise Timeout(f"nothing came within {timeout:g} s") from None
