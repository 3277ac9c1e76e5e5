# SPDX-License-Identifier: Apache-2.0
"""Streams for asyncio, like those of `cm.client.stream`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, TypeVar

from cm.client.aio.request_reply import Subscription
from cm.client.aio.waiting import Waits
from cm.client.core.flow_effects import DEFAULT, Deadline, Limit, seconds, time_limit
from cm.client.core.generations import FirstAfter, Written
from cm.client.core.remote_stream import NewestReader, PublishedReader, Reader, Wanted
from cm.client.errors import BoardClosed
from cm.client.frame import Frame
from cm.client.stream import LocalStream
from cm.errors import Timeout
from cm.wire.plane_packets import Geometry, Open

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller

Self = TypeVar("Self", bound="Stream")


class Stream:
    """Frames of one stream: ``async for``, or ``await read()``; also an async context manager."""

    name: str
    _timeout: float | None

    async def read(self, timeout: Limit = DEFAULT) -> Frame:
        """The next frame. `timeout` in seconds (None waits for ever; default: the stream's). Raises Timeout."""
        raise NotImplementedError

    async def after(self, write: Written | int, timeout: Limit = DEFAULT) -> Frame:
        """The first frame that began after a write was complete; earlier ones are skipped.

        `write` is what `registers.write` returned, or a generation of the registers. Raises Timeout.
        """
        wanted = FirstAfter(self.name, write, timeout, self._timeout)
        while True:
            try:
                frame = await self.read(wanted.left())
            except Timeout:
                raise wanted.nothing() from None
            if wanted.has(frame):
                return frame

    async def open(self) -> None:
        """Connect; `read` does it by itself. Raises RequestNotFound for an unknown stream."""
        raise NotImplementedError

    async def close(self) -> None:
        """Disconnect, for good; twice is fine. Later reads, and tasks that wait for a frame, say so."""
        raise NotImplementedError

    async def aclose(self) -> None:
        """`close`, for `contextlib.aclosing`."""
        await self.close()

    @property
    def lost(self) -> int:
        """Frames missing between those that were read; see `cm.client.stream.Stream.lost`."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<stream {self.name}>"

    async def __aiter__(self) -> AsyncIterator[Frame]:
        while True:
            yield await self.read()

    async def __aenter__(self: Self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.close()


class AsyncLocalStream(Stream):
    """Frames in DMA memory; see `cm.client.stream.LocalStream`."""

    def __init__(self, board: Caller, folder: Path, wanted: Open, timeout: float | None, newest: bool = False) -> None:
        self._stream = LocalStream(folder, wanted, timeout, newest, owner=board)
        self._waits = Waits()
        self._timeout = time_limit(timeout)
        self.name = wanted.name

    async def open(self) -> None:
        await asyncio.get_running_loop().run_in_executor(None, self._stream.open)

    @property
    def geometry(self) -> Geometry | None:
        """The current shape, dtype and slots; None while the stream is stopped."""
        return self._stream.geometry

    @property
    def lost(self) -> int:
        return self._stream.lost

    async def read(self, timeout: Limit = DEFAULT) -> Frame:
        if not self._stream.is_open:
            await self.open()
        deadline = Deadline(seconds(timeout, self._timeout))
        await asyncio.sleep(0)  # others have their turn, however many frames come
        while (frame := self._stream.poll()) is None:
            try:
                await self._waits.readable(self._stream.fileno(), deadline.left)
            except asyncio.TimeoutError:
                raise Timeout(self._stream.nothing(deadline.limit)) from None
        return frame

    async def close(self) -> None:
        self._waits.end()
        self._stream.close()

    def end(self, because: BoardClosed) -> None:
        """The board is closed; any later use, and tasks that wait for a frame, raise BoardClosed."""
        self._waits.end()
        self._stream.end(because)


class AsyncRemoteStream(Stream):
    """Frames over ZeroMQ; losses show in `sequence`."""

    def __init__(self, board: Caller, wanted: Wanted) -> None:
        self.name = wanted.name
        self._timeout = time_limit(wanted.timeout)
        self._board = board  # keeps the board alive
        self._reader: Reader = NewestReader(wanted) if wanted.newest else PublishedReader(wanted, self._listen)

    @property
    def _listen(self) -> Callable[[bytes, int], Subscription]:
        return lambda topic, depth: self._board.subscribe(topic, depth=depth)

    @property
    def lost(self) -> int:
        return self._reader.lost

    async def open(self) -> None:
        await self._board.run(self._reader.opening())

    async def read(self, timeout: Limit = DEFAULT) -> Frame:
        return await self._board.run(self._reader.reading(timeout))

    async def close(self) -> None:
        self._reader.close()

    def __del__(self) -> None:
        self._reader.close()
