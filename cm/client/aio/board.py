# SPDX-License-Identifier: Apache-2.0
"""The board of the asyncio client."""

from __future__ import annotations

import asyncio
import os
import weakref
from collections.abc import Generator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy.typing as npt
import zmq.asyncio

from cm.client.aio.interrupts import Interrupts
from cm.client.aio.memories import Memories
from cm.client.aio.operations import Operations
from cm.client.aio.registers import Registers
from cm.client.aio.request_reply import Link
from cm.client.aio.stream import AsyncLocalStream, AsyncRemoteStream, Stream
from cm.client.aio.writer import AsyncTransfers, AsyncWriter
from cm.client.connections import ByName, Sockets
from cm.client.core import calls
from cm.client.core.flow_effects import DEFAULT, Limit, seconds, time_limit
from cm.client.core.leases import HeldLeases
from cm.client.core.remote_stream import Wanted
from cm.client.find_manager import Keys, find
from cm.wire.messages.status import ClockStatus, RegionStatus, Status
from cm.wire.plane_packets import Open, Purpose

if TYPE_CHECKING:
    from cm.client.allocation import DeviceArray
    from cm.client.register_window import RegisterWindow

_PATIENCE = 0.002  # seconds that a read over the data socket may take, while the event loop waits, before a request


def connect(
    endpoint: str | os.PathLike[str] | None = None,
    *,
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout: float | None = 5.0,
    keys: str | os.PathLike[str] | Keys | None = None,
    guest: str = "",
) -> Board:
    """A board, to be entered with ``async with``, or awaited; arguments and errors as in `cm.connect`."""
    return Board(endpoint, runtime_dir=runtime_dir, timeout=timeout, keys=keys, guest=guest)


class Board(Operations):
    """A board behind a configuration manager. One event loop; several requests may be under way."""

    _advice = {"mode": "await board.set_mode(…): an assignment cannot be awaited"}  # noqa: RUF012 (never changed)

    # Attributes rather than properties, which completion does not evaluate: board.registers["<TAB>.
    registers: Registers
    """Registers and fields of the current mode by name."""
    interrupts: Interrupts
    """Interrupts of the loaded configuration by name."""
    memories: Memories
    """Memories of the current mode by name."""

    def __init__(
        self,
        endpoint: str | os.PathLike[str] | None = None,
        *,
        runtime_dir: str | os.PathLike[str] | None = None,
        timeout: float | None = 5.0,
        keys: str | os.PathLike[str] | Keys | None = None,
        guest: str = "",
    ) -> None:
        timeout = time_limit(timeout)
        self._place = find(endpoint, runtime_dir, keys, guest)
        self._sockets = Sockets(zmq.asyncio.Context(), self._place.endpoints, self._place.keys)
        # Not __del__: a finalizer also runs when the interpreter ends, before modules that it needs are taken apart.
        self._close = weakref.finalize(self, self._sockets.close)
        self._link = Link(self._sockets, timeout, guest)
        self._leases = HeldLeases()
        reads = ByName(self._sockets, self._place.data, self._link.unanswered, _PATIENCE)
        # Set directly, because Guarded refuses to; not properties, since each access to a register would run them.
        object.__setattr__(self, "registers", Registers(self, self._window, reads))
        object.__setattr__(self, "interrupts", Interrupts(self))
        object.__setattr__(self, "memories", Memories(self))

    async def _gone(self) -> None:
        """Until the manager goes away, whether or not something is asked of it. Raises ConnectionLost."""
        await self._link.gone()

    # ---- status -----------------------------------------------------------------------

    async def status(self) -> Status:
        """The state of the PL now."""
        return await self.ask(calls.status())

    async def modes(self) -> tuple[str, ...]:
        """The modes of the loaded configuration."""
        return tuple([mode.name for mode in (await self.ask(calls.describe())).modes])

    async def regions(self) -> dict[str, RegionStatus]:
        """The regions by name: the module in each, and its state."""
        return {region.name: region for region in (await self.ask(calls.status())).regions}

    async def clocks(self) -> dict[str, ClockStatus]:
        """The clocks by name: the rate that the configuration wants, and the one that each has, in Hz."""
        return {clock.name: clock for clock in (await self.ask(calls.status())).clocks}

    # ---- configurations -----------------------------------------------------------------

    async def configs(self) -> tuple[str, ...]:
        """Names of the configurations that can be loaded."""
        return await self.ask(calls.config_names())

    async def mode(self) -> str:
        """The mode the board is in; `set_mode` goes to one."""
        return (await self.status()).mode

    # ---- data -----------------------------------------------------------------------------

    def stream(
        self,
        name: str,
        timeout: float | None = 5.0,
        *,
        depth: int = 0,
        newest: bool = False,
        lease: str = "",
        copy: bool = False,
        raw: bool = False,
    ) -> Stream:
        """The frames of a stream, as a context manager and iterator; lost frames show as gaps in `sequence`.

        On the manager's machine frames are not copied: arrays lie in DMA memory, `depth` of them (0: 4) may be
        held at a time, and go back when the last reference to them goes. `newest` skips frames that are followed by a
        newer one. From elsewhere they come over ZeroMQ: `newest` asks for each frame when it is read, and `depth` of
        them (0: 4) wait here, beside those at the manager. `timeout` in seconds, None waits for ever. `lease`: your
        lease's id, if a stream with back-pressure belongs to a region under a lease.
        `copy`: use ZeroMQ on the manager's machine too, so that nobody else can access the frames (docs/security.md).
        Guests of a bridge request each frame (`newest`), in their own name.
        A stream with a `format` gives RGB, as copies unless it is `rgb`; `raw`: its bytes as they are.
        """
        if self._place.data is not None and not copy:
            wanted = Open(name, depth=depth, lease=self._leases.named(lease), raw=raw)
            return self._sockets.using(AsyncLocalStream(self, self._place.data, wanted, timeout, newest))
        published = Wanted(name, timeout, newest or bool(self._place.guest), depth, raw)
        return AsyncRemoteStream(self, published)

    def writer(self, name: str, timeout: float | None = 5.0, *, depth: int = 0, lease: str = "") -> AsyncWriter:
        """Write a stream without copies: ``async with writer.slot() as array: array[...] = frame``.

        `depth` slots (0: 4) are ours. On the manager's machine only; `write` works from anywhere.
        `lease`: your lease's id, if the stream's region is under a lease.
        """
        wanted = Open(name, Purpose.WRITE, depth=depth, lease=self._leases.named(lease))
        return self._sockets.using(AsyncWriter(self, self._place.data_folder("a writer"), wanted, timeout))

    def echo(self, length: int, timeout: float | None = 5.0, *, depth: int = 2) -> AsyncWriter:
        """Slots of `length` bytes that need no hardware: what is sent is done at once. For measuring."""
        wanted = Open("", Purpose.ECHO, depth=depth, length=length)
        return self._sockets.using(AsyncWriter(self, self._place.data_folder("an echo"), wanted, timeout))

    def transfers(self, name: str, timeout: float | None = 5.0, *, lease: str = "") -> AsyncTransfers:
        """Transfer arrays of `allocate` to a stream, or from it into them: ``await transfers.begin(array)``.

        The stream is nobody else's meanwhile (RequestBusy). On the manager's machine only.
        """
        wanted = Open(name, Purpose.TRANSFER, lease=self._leases.named(lease))
        return self._sockets.using(AsyncTransfers(self, self._place.data_folder("a transfer"), wanted, timeout))

    async def allocate(
        self, shape: int | Sequence[int], dtype: npt.DTypeLike = "uint8", timeout: Limit = DEFAULT
    ) -> DeviceArray:
        """An array in contiguous memory, for masters in the PL: ``{"source": array.device_address}``.

        It is zero at first, and is given back with the last array in it, or with this process. On the manager's
        machine only. Raises InvalidRequest, RequestBusy if the manager gives no more, Timeout.
        """
        self._check_open()
        folder, limit = self._place.data_folder("memory for the PL"), seconds(timeout, self.timeout)
        from cm.client.allocation import allocated  # imported here: only Linux has such sockets

        wait = asyncio.get_running_loop().run_in_executor
        return await wait(None, allocated, folder, shape, dtype, limit, self._sockets.using)

    async def _window(self, wanted: Open, timeout: Limit) -> RegisterWindow:
        self._check_open()
        folder = self._place.data_folder("a window")
        limit = None if wanted.wait and timeout is DEFAULT else seconds(timeout, self.timeout)
        from cm.client.register_window import RegisterWindow  # here: it needs the shim, which only Linux has

        window = self._sockets.using(RegisterWindow(folder, wanted, limit, self._leases, owner=self))
        try:
            await asyncio.get_running_loop().run_in_executor(None, window.open)
        except BaseException:  # also the end of the task, while the thread waits
            window.close()
            raise
        return window

    # ---- life -----------------------------------------------------------------------------

    async def close(self) -> None:
        """Disconnect, with all streams, writers and events; any later use raises BoardClosed.

        Twice is fine.
        """
        self._sockets.refuse()
        await self._link.close()
        self._close()

    async def __aenter__(self) -> Board:
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

    def __await__(self) -> Generator[Any, None, Board]:
        """``board = await cm.aio.connect()``; it is closed with ``await board.close()``."""
        return self.__aenter__().__await__()
