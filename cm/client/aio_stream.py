# SPDX-License-Identifier: Apache-2.0
"""Streams for asyncio: the twins of `cm.client.stream` and `cm.client.writer`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy.typing as npt
import zmq
import zmq.asyncio

from cm.client.frame import Frame, frame_of
from cm.client.link import STREAM_HWM
from cm.client.stream import LocalStream
from cm.client.writer import Writer
from cm.errors import Timeout
from cm.messages.status import FrameInfo
from cm.wire import topics
from cm.wire.encode import decode_event
from cm.wire.plane import Open

Self = TypeVar("Self", bound="Stream")


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

    def __init__(self, folder: Path, name: str, timeout: float | None, depth: int = 0, newest: bool = False) -> None:
        self._stream = LocalStream(folder, name, timeout, depth, newest)
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
    """Frames over ZeroMQ."""

    def __init__(
        self,
        check: Callable[[], Awaitable[Any]],
        subscribe: Callable[[], zmq.asyncio.Socket],
        name: str,
        timeout: float | None,
    ) -> None:
        self._check, self._subscribe, self._name = check, subscribe, name
        self._timeout = timeout
        self._socket: zmq.asyncio.Socket | None = None
        self._expected: int | None = None
        self._lost = 0

    @property
    def lost(self) -> int:
        return self._lost

    async def open(self) -> None:
        if self._socket is None:
            await self._check()  # raises for an unknown stream
            self._socket = self._subscribe()
            self._socket.setsockopt(zmq.RCVHWM, STREAM_HWM)
            self._socket.setsockopt(zmq.SUBSCRIBE, topics.STREAM_PREFIX + self._name.encode())

    async def read(self, timeout: float | None = None) -> Frame:
        await self.open()
        assert self._socket is not None
        frames = await receive(self._socket, self._timeout if timeout is None else timeout)
        info = decode_event(frames)
        assert isinstance(info, FrameInfo)
        if self._expected is not None and info.sequence > self._expected:
            self._lost += info.sequence - self._expected
        self._expected = info.sequence + 1
        return frame_of(info, frames[2])

    async def aclose(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


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
