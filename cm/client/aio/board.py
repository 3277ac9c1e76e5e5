# SPDX-License-Identifier: Apache-2.0
"""The board of the asyncio client."""

from __future__ import annotations

import asyncio
import os
import weakref
from collections.abc import Generator, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy.typing as npt
import zmq.asyncio

from cm.client.aio.change import ChangeHandle
from cm.client.aio.events import EventStream
from cm.client.aio.interrupts import Interrupts
from cm.client.aio.lease import BoardLease
from cm.client.aio.memories import Memories, Memory
from cm.client.aio.registers import Registers
from cm.client.aio.request_reply import Link, Subscription
from cm.client.aio.stream import AsyncLocalStream, AsyncRemoteStream, Stream
from cm.client.aio.writer import AsyncTransfers, AsyncWriter
from cm.client.attribute_guard import Guarded
from cm.client.connections import ByName, Sockets
from cm.client.core import calls, change, leases, uploads
from cm.client.core.calls import Call
from cm.client.core.events import StatusEvents
from cm.client.core.flow_effects import DEFAULT, Flow, Limit, at_least, later, seconds, time_limit
from cm.client.core.leases import HeldLeases
from cm.client.core.remote_stream import Wanted
from cm.client.core.value_checks import mode_name
from cm.client.errors import RequestFailed
from cm.client.find_manager import Keys, find
from cm.client.frame import Frame
from cm.client.progress import OnProgress, Shown
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ConfigureStream, DefineMemory
from cm.wire.messages.status import (
    ClientStatus,
    ClockStatus,
    ConfigEntry,
    ConfigInfo,
    FrameInfo,
    LeaseInfo,
    PlanInfo,
    RegionCheck,
    RegionMap,
    RegionStatus,
    Status,
    StreamStatus,
)
from cm.wire.plane_packets import Open, Purpose

if TYPE_CHECKING:
    from cm.client.allocation import DeviceArray
    from cm.client.register_window import RegisterWindow

_T = TypeVar("_T")
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


class Board(Guarded):
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

    @property
    def timeout(self) -> float | None:
        """Seconds to wait for the answer to any request but `load`; None waits for ever."""
        return self._link.timeout

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        self._link.timeout = time_limit(seconds)

    # ---- asking ---------------------------------------------------------------------

    async def ask(self, call: Call[_T], timeout: Limit = DEFAULT) -> _T:
        """Make a call and return its result; `timeout` in seconds, None waits for ever.

        Raises what `cm.client.errors` holds.
        """
        return await self._link.ask(self._leases.carried(call), seconds(timeout, self._link.timeout))

    async def run(self, flow: Flow[_T]) -> _T:
        """Run a flow of `cm.client.core` to its end."""
        return await self._link.run(flow)

    def subscribe(self, *topics: bytes, depth: int = 0) -> Subscription:
        """Listen to topics; `depth` messages wait (0: ZeroMQ's own number). The caller closes it.

        Raises InvalidRequest for a guest of a bridge: publications go to the bridge.
        """
        self._place.check_subscription()
        return Subscription(self._sockets, topics, depth)

    def _changes(self) -> Subscription:
        return Subscription(self._sockets, StatusEvents.topics)

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

    async def break_lease(self, number: int) -> LeaseInfo:
        """End another client's lease, by its number in `status.leases`; needs the role admin."""
        return await self.ask(calls.lease(rq.BreakLease(number)))

    async def clients(self) -> tuple[ClientStatus, ...]:
        """What each client uses of the manager: connections, leases, slots, bytes, the loop's time."""
        return await self.ask(calls.clients())

    def watch(self, timeout: float | None = None) -> EventStream[Status]:
        """Every status from now on, the current one first. Raises Timeout if none comes for `timeout` seconds."""
        subscription = self.subscribe(*StatusEvents.topics)
        return EventStream(self, subscription, StatusEvents(subscription, timeout))

    # ---- configurations -----------------------------------------------------------------

    async def configs(self) -> tuple[str, ...]:
        """Names of the configurations that can be loaded."""
        return await self.ask(calls.config_names())

    async def config_entries(self) -> tuple[ConfigEntry, ...]:
        """All configurations with their modes, and the sender of those that did not come from the administrator."""
        return await self.ask(calls.config_entries())

    async def remove_config(self, name: str, lease: str = "") -> None:
        """Remove a configuration that a client sent, with its files: your own, or with the role admin anyone's."""
        await self.ask(calls.remove_config(name, lease), timeout=at_least(self.timeout, 60.0))

    async def config(self, name: str = "") -> ConfigInfo:
        """A configuration's modes, registers, streams and interrupts; the loaded one's if no name is given."""
        return await self.ask(calls.describe(name))

    async def load(
        self,
        config: str = "",
        mode: str = "",
        *,
        progress: OnProgress | bool | None = None,
        timeout: float | None = None,
        queue: bool = True,
        force: bool = False,
        lease: str = "",
    ) -> float:
        """Go to a mode of a configuration and wait until the board is there; returns the seconds it took.

        `progress` is called with each step. Without it a notebook shows a bar; True draws one on a terminal too,
        False none anywhere. Raises RequestFailed (the board is then where the sentence says), ConnectionLost, NoAnswer.
        """
        call = self._leases.carried(calls.load(config, mode, wait=True, queue=queue, force=force, lease=lease))
        with Shown(progress, config, mode) as shown:
            subscription = self._changes() if shown.tell else None
            try:
                return await self.run(change.loading(call, timeout, subscription, shown.tell))
            finally:
                if subscription is not None:
                    subscription.close()

    async def load_async(
        self, config: str = "", mode: str = "", *, queue: bool = True, force: bool = False, lease: str = ""
    ) -> ChangeHandle:
        """Ask for a mode and return at once; the handle tells when the board has reached it."""
        subscription = self._changes()
        try:
            info = await self.ask(calls.load(config, mode, wait=False, queue=queue, force=force, lease=lease))
        except BaseException:  # CancelledError too: nothing else would close it
            subscription.close()
            raise
        return ChangeHandle(self, info.number, subscription)

    async def mode(self) -> str:
        """The mode the board is in; `set_mode` goes to one."""
        return (await self.status()).mode

    async def set_mode(self, mode: str, *, timeout: float | None = None, lease: str = "") -> float:
        """Go to a mode of the loaded configuration and wait; returns the seconds it took. Raises as `load` does."""
        return await self.load(mode=mode_name(mode), timeout=timeout, lease=lease)

    async def unload(self, region: str = "", *, timeout: float | None = None, lease: str = "") -> float:
        """Empty a region, or all regions, and wait; returns the seconds it took. Raises as `load` does.

        Its streams stop, its overlays go, it is isolated; the configuration stays. The mode ends if it needs the
        region. Nothing is offered of it until it is loaded again.
        """
        return (await self.ask(calls.unload(region, lease), timeout)).seconds

    async def cancel(self) -> None:
        """Cancel the running change before its next load; the board goes back."""
        await self.ask(calls.cancel())

    async def plan(self, mode: str = "", config: str = "", *, unload: str = "") -> PlanInfo:
        """What a change to a mode would do, and how long it would take; changes nothing.

        `unload`: what unloading this region would do; "*": all.
        """
        return await self.ask(calls.plan(mode, config, unload), timeout=at_least(self.timeout, 30.0))

    async def check_region(
        self, name: str, *, repair: bool = False, reload: bool = False, lease: str = "", timeout: Limit = DEFAULT
    ) -> RegionCheck:
        """Read a region's configuration back and compare it with what was loaded; `repair` it, and do so again.

        `reload`: repair by loading the whole region. Raises RequestFailed with the code no_readback where the board's
        port cannot be read, region_wrong where the region differs also after it was loaded again.
        """
        limit = at_least(self.timeout, 60.0) if timeout is DEFAULT else timeout
        return await self.ask(calls.check_region(name, repair, reload, lease), timeout=limit)

    async def map_region(self, name: str) -> RegionMap:
        """What was loaded into a region of a 7-series device: set bits by frame and by row of tiles (`cm region map`).

        Raises RequestFailed with the code unknown_device where the device's columns are not known.
        """
        return await self.ask(calls.map_region(name), timeout=at_least(self.timeout, 30.0))

    async def provision(
        self, schema: str | os.PathLike[str], *files: str | os.PathLike[str], lease: str = ""
    ) -> ConfigInfo:
        """Send a schema file with the bitstreams and overlays that belong to it; it can then be loaded."""
        call = await self.run(uploads.provision(Path(schema), tuple(map(Path, files)), lease))
        return await self._ask_with_uploads(call, at_least(self.timeout, 60.0))

    def lease(
        self, scope: str = "board", *, exclusive: bool = True, seconds: float = 30.0, holder: str = ""
    ) -> BoardLease:
        """Hold ``board``, ``config``, ``region:NAME``, ``registers:NAME`` or ``memories:NAME`` as a context manager.

        Within it this board's own calls pass. `holder` is the name that others see (default: this process or guest).
        """
        return BoardLease(self, self._leases, leases.wanted(scope, exclusive, seconds, holder, self._place))

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

    def _check_open(self) -> None:
        if self._sockets.closed:
            raise self._sockets.gone()

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

    async def read(self, stream: str = "", timeout: float | None = 1.0) -> Frame:
        """The next frame of a stream; `timeout` in seconds, None waits for ever. Raises RequestTimeout."""
        from cm.client.core.remote_stream import reading_next  # imported here: it needs numpy

        return await self.run(reading_next(stream, timeout, self.timeout))

    async def _ask_with_uploads(self, call: Call[_T], timeout: Limit) -> _T:
        try:
            return await self.ask(call, timeout)
        except RequestFailed:
            await self.run(uploads.discarding(call))
            raise

    async def write(self, stream: str, data: Any, lease: str = "") -> FrameInfo:
        """Send an array or bytes to the hardware; returns when the hardware has taken them.

        An array (rows, columns, 3) for a stream with a `format` is RGB; all else is sent as it is.
        """
        call = await self.run(uploads.write_data(stream, data, lease))
        try:
            return await self._ask_with_uploads(call, later(self.timeout, 5.0))
        except RequestFailed as error:
            call = await self.run(uploads.recoded(error, stream, data, lease))
        return await self._ask_with_uploads(call, later(self.timeout, 5.0))

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

    async def configure_stream(
        self,
        stream: str,
        *,
        shape: Sequence[int] = (),
        dtype: str = "",
        slots: int = 0,
        direction: str = "",
        rate: float = 0.0,
        stride: int = 0,
        cyclic: bool | None = None,
        backpressure: bool | None = None,
        enable: bool | None = None,
        automatic: bool = False,
        force: bool = False,
        lease: str = "",
    ) -> StreamStatus:
        """Change settings of a stream; those that are left out, empty, 0 or None stay as they are.

        `rate`: frames handed on per second at most; infinity: all that come. `stride`: bytes from line to line.
        `enable`: start or stop it for all; `automatic`: it runs while a client uses it, as it does before any `enable`.
        Raises RequestBusy while it is in use, without `force`, and InvalidRequest for impossible settings; then nothing
        has changed.
        """
        request = ConfigureStream(
            stream, calls.axes(stream, shape), dtype=dtype, slots=slots, direction=direction, rate=rate, stride=stride,
            cyclic=cyclic, backpressure=backpressure, enable=enable, automatic=automatic, force=force,
            lease=lease,
        )  # fmt: skip
        return await self.ask(calls.configure_stream(request))

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

        They must lie in the window of a UIO device. `access`: "rw" (default), "ro" or "wo"; writable ones must not
        cover anything with a name. `region`: the region whose module answers there, or "static"; not needed if all
        other names in that window belong to the same region. Raises RequestFailed.
        """
        request = DefineMemory(
            name, address, length=length, shape=shape, dtype=dtype, access=access, region=region, lease=lease
        )
        await self.ask(calls.define_memory(request))
        return Memory(self, name)

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

    def __repr__(self) -> str:
        return f"<board at {self._place.endpoints.req}{', closed' if self._sockets.closed else ''}>"
