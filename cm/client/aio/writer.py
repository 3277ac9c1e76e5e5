# SPDX-License-Identifier: Apache-2.0
"""Writing frames without copies, for asyncio, like `cm.client.writer`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from cm.client.aio.waiting import Waits
from cm.client.core.flow_effects import DEFAULT, Deadline, Limit, seconds, time_limit
from cm.client.errors import BoardClosed
from cm.errors import InvalidRequest, Timeout
from cm.wire.plane_packets import Descriptor, Geometry, Open

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller
    from cm.client.allocation import DeviceArray
    from cm.client.writer import Writer


class AsyncWriter:
    """Borrow slots, fill them, send them; see `Writer`. Entered with ``async with``."""

    def __init__(self, board: Caller, folder: Path, wanted: Open, timeout: float | None) -> None:
        self._board = board  # keeps the board alive
        self._folder, self._wanted, self._timeout = folder, wanted, time_limit(timeout)
        self.name: str = wanted.name
        self._ended: BoardClosed | None = None
        self._writer: Writer | None = None
        self._waits = Waits()

    async def __aenter__(self) -> AsyncWriter:
        kind = self._kind()

        def opened() -> None:
            writer = self._writer = kind(self._folder, self._wanted, self._timeout)
            if self._ended is not None:  # an end() from here on finds the writer
                writer.end(self._ended)
            writer.open()

        await asyncio.get_running_loop().run_in_executor(None, opened)
        return self

    @staticmethod
    def _kind() -> type[Writer]:
        """What does the work, in a thread while it opens."""
        from cm.client.writer import Writer  # imported here: only Linux has such sockets

        return Writer

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect; frames under way are still sent. Twice is fine."""
        if self._writer is not None:
            self._writer.close()

    def end(self, because: BoardClosed) -> None:
        """The board is closed; any later use, and tasks that wait for a slot, raise BoardClosed."""
        self._ended = because
        self._waits.end()
        if self._writer is not None:
            self._writer.end(because)

    def _entered(self) -> Writer:
        if self._ended is not None:
            raise self._ended
        if self._writer is None:
            raise InvalidRequest("enter the writer first: async with board.writer(…) as writer")
        return self._writer

    @asynccontextmanager
    async def slot(self, length: int = 0, timeout: Limit = DEFAULT) -> AsyncIterator[npt.NDArray[Any]]:
        """A free slot as an array to fill; it is sent when the block ends."""
        writer = self._entered()
        await self._until(lambda: writer.free > 0, timeout)
        with writer.lend(length) as array:
            yield array

    async def write(self, data: npt.ArrayLike, timeout: Limit = DEFAULT) -> None:
        """Copy a frame into a slot and send it. Raises as `slot` does."""
        writer = self._entered()
        await self._until(lambda: writer.free > 0, timeout)
        writer.send(data)

    @property
    def under_way(self) -> int:
        """Frames that the hardware has not taken yet."""
        return self._entered().under_way

    @property
    def free(self) -> int:
        """Slots that are available at once."""
        return self._entered().free

    @property
    def geometry(self) -> Geometry | None:
        """Shape, dtype, slots; None while the stream is stopped."""
        return self._entered().geometry

    async def round_trip(self, length: int = 0) -> Descriptor:
        """Send a slot as it is and wait until it is done: the cost of a frame without its bytes."""
        writer = self._entered()
        await self._until(lambda: writer.free > 0, DEFAULT)
        return await asyncio.get_running_loop().run_in_executor(None, writer.round_trip, length)

    async def flush(self, timeout: Limit = DEFAULT) -> None:
        """Wait until the hardware has taken all frames. Raises Timeout, TransferFailed."""
        writer = self._entered()
        await self._until(lambda: writer.under_way == 0, timeout)
        writer.flush()

    async def _until(self, ready: Callable[[], bool], timeout: Limit) -> None:
        writer, deadline = self._entered(), Deadline(seconds(timeout, self._timeout))
        writer.catch_up()
        await asyncio.sleep(0)  # others have their turn, however many slots are free
        while not ready():
            if writer.poll():
                continue
            try:
                await self._waits.readable(writer.fileno(), deadline.left)
            except asyncio.TimeoutError:
                raise Timeout(writer.nothing(deadline.limit)) from None

    def __repr__(self) -> str:
        return f"<writer of {self.name or 'an echo'}>"


class AsyncTransfers(AsyncWriter):
    """Transfers of one's own memory; see `Transfers`. Entered with ``async with``."""

    @staticmethod
    def _kind() -> type[Writer]:
        from cm.client.writer import Transfers

        return Transfers

    async def begin(self, array: DeviceArray, start: int = 0, nbytes: int = 0, timeout: Limit = DEFAULT) -> None:
        """Begin to transfer `nbytes` (0: the rest) of an array of `Board.allocate`, from byte `start` on.

        Raises as `Transfers.begin`.
        """
        transfers: Any = self._entered()
        await self._until(lambda: transfers.free > 0, timeout)
        transfers.begin(array, start, nbytes)

    @property
    def moved(self) -> int:
        """Bytes that the last one moved."""
        return self._entered().moved
