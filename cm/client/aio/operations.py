# SPDX-License-Identifier: Apache-2.0
"""What a board does by requests alone; setup.py makes the blocking `cm.client._operations` of it, without `await`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cm.client.aio.change import ChangeHandle
from cm.client.aio.events import EventStream
from cm.client.aio.lease import BoardLease
from cm.client.aio.memories import Memory
from cm.client.aio.request_reply import Link, Subscription
from cm.client.attribute_guard import Guarded
from cm.client.connections import Sockets
from cm.client.core import calls, change, leases, uploads
from cm.client.core.calls import Call
from cm.client.core.events import StatusEvents
from cm.client.core.flow_effects import DEFAULT, Flow, Limit, at_least, later, seconds, time_limit
from cm.client.core.leases import HeldLeases
from cm.client.core.value_checks import mode_name
from cm.client.errors import RequestFailed
from cm.client.find_manager import Place
from cm.client.progress import OnProgress, Shown
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ConfigureStream, DefineMemory
from cm.wire.messages.status import (
    ClientStatus,
    ConfigEntry,
    ConfigInfo,
    FrameInfo,
    LeaseInfo,
    PlanInfo,
    RegionCheck,
    RegionMap,
    Status,
    StreamStatus,
)

if TYPE_CHECKING:
    from cm.client.frame import Frame

_T = TypeVar("_T")


class Operations(Guarded):
    """The part of a board that needs no sockets of its own."""

    _place: Place
    _sockets: Sockets
    _link: Link
    _leases: HeldLeases

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
        link, held = self._link, self._leases
        carried = held.carried(call) if held.held else call
        return await link.ask(carried, link.timeout if timeout is DEFAULT else seconds(timeout, None))

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

    # ---- status and configurations ----------------------------------------------------

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
        except BaseException:  # the end of the task, or Ctrl-C, too: nothing else would close it
            subscription.close()
            raise
        return ChangeHandle(self, info.number, subscription)

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

    def _check_open(self) -> None:
        if self._sockets.closed:
            raise self._sockets.gone()

    def __repr__(self) -> str:
        return f"<board at {self._place.endpoints.req}{', closed' if self._sockets.closed else ''}>"
