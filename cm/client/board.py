# SPDX-License-Identifier: Apache-2.0
"""The blocking client: `connect()` gives a `Board`."""

from __future__ import annotations

import os
import weakref
from collections.abc import Sequence
from functools import cached_property
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

import zmq

from cm.client._operations import Operations
from cm.client.connections import ByName, Sockets
from cm.client.core import calls
from cm.client.core.flow_effects import DEFAULT, Limit, seconds, time_limit
from cm.client.core.leases import HeldLeases
from cm.client.find_manager import Keys, find
from cm.client.interrupts import Interrupts
from cm.client.memories import Memories
from cm.client.progress import ipython_shell
from cm.client.registers import Registers
from cm.client.request_reply import Link
from cm.errors import CmError
from cm.wire.messages import notebook
from cm.wire.messages.status import ClockStatus, RegionStatus, Status
from cm.wire.plane_packets import Open, Purpose

if TYPE_CHECKING:
    import numpy.typing as npt

    from cm.client.allocation import DeviceArray
    from cm.client.blocks import Blocks
    from cm.client.register_window import RegisterWindow
    from cm.client.stream import Stream
    from cm.client.writer import Transfers, Writer

_W = TypeVar("_W", bound="Writer")
_PATIENCE = 0.05  # seconds that a read over the data socket may take before it is made by a request


def connect(
    endpoint: str | os.PathLike[str] | None = None,
    *,
    runtime_dir: str | os.PathLike[str] | None = None,
    timeout: float | None = 5.0,
    keys: str | os.PathLike[str] | Keys | None = None,
    guest: str = "",
) -> Board:
    """Connect to a configuration manager and check that it answers.

    Args:
        endpoint: ``tcp://host[:port]`` or a runtime folder; default: `$CM_CONNECT`, or else the manager of this
        machine.
        runtime_dir: the runtime folder, spelt out.
        timeout: seconds to wait for answers to all but `load`.
        keys: a client's key file (``cm keygen``), or the keys; default over TCP: the file `$CM_KEYS`, if that is set.
        guest: the guest in whose name a bridge makes its requests, if it may speak for that guest (docs/security.md,
        Bridges).

    Raises NotFound if no manager serves, NoAnswer if none answers.
    """
    board = Board(endpoint, runtime_dir=runtime_dir, timeout=timeout, keys=keys, guest=guest)
    try:
        _ = board.status
    except BaseException:  # also Ctrl-C while no manager answers
        board.close()
        raise
    if (shell := ipython_shell()) is not None:
        shell.extension_manager.load_extension("cm.client.ipython")
    return board


class Board(Operations):
    """A board behind a configuration manager. Use as a context manager. Threads may share it."""

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
        self._sockets = Sockets(zmq.Context(), self._place.endpoints, self._place.keys)
        # Not __del__: a finalizer also runs when the interpreter ends, before modules that it needs are taken apart.
        self._close = weakref.finalize(self, self._sockets.close)
        self._link = Link(self._sockets, timeout, guest)
        self._leases = HeldLeases()
        reads = ByName(self._sockets, self._place.data, self._link.unanswered, _PATIENCE)
        # Set directly, because Guarded refuses to; not properties, since each access to a register would run them.
        object.__setattr__(self, "registers", Registers(self, self._window, reads))
        object.__setattr__(self, "interrupts", Interrupts(self))
        object.__setattr__(self, "memories", Memories(self))

    # ---- status -----------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """The state of the PL now."""
        return self.ask(calls.status())

    @property
    def modes(self) -> tuple[str, ...]:
        """The modes of the loaded configuration."""
        return tuple([mode.name for mode in self.ask(calls.describe()).modes])

    @property
    def regions(self) -> dict[str, RegionStatus]:
        """The regions by name: the module in each, and its state."""
        return {region.name: region for region in self.ask(calls.status()).regions}

    @property
    def clocks(self) -> dict[str, ClockStatus]:
        """The clocks by name: the rate that the configuration wants, and the one that each has, in Hz."""
        return {clock.name: clock for clock in self.ask(calls.status()).clocks}

    @cached_property
    def blocks(self) -> Blocks:
        """The IPs of the loaded configuration by instance."""
        from cm.client.blocks import Blocks

        return Blocks(self)

    # ---- configurations -----------------------------------------------------------------

    @property
    def configs(self) -> tuple[str, ...]:
        """Names of the configurations that can be loaded."""
        return self.ask(calls.config_names())

    @property
    def mode(self) -> str:
        """The mode that the board is in; setting it changes the mode and waits."""
        return self.status.mode

    @mode.setter
    def mode(self, mode: str) -> None:
        self.set_mode(mode)

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
        from cm.client.core.remote_stream import Wanted
        from cm.client.stream import LocalStream, NewestStream, RemoteStream  # imported here: they need numpy

        if self._place.data is not None and not copy:
            wanted = Open(name, depth=depth, lease=self._leases.named(lease), raw=raw)
            return self._sockets.using(LocalStream(self._place.data, wanted, timeout, newest, owner=self))
        published = Wanted(name, timeout, newest or bool(self._place.guest), depth, raw)
        if published.newest:
            return NewestStream(self, published, self._new_link)
        return RemoteStream(self, published)

    def _new_link(self) -> Link:
        return Link(self._sockets, self.timeout, self._place.guest)

    def writer(self, name: str, timeout: float | None = 5.0, *, depth: int = 0, lease: str = "") -> Writer:
        """Write a stream without copies: ``with writer.slot() as array: array[...] = frame``.

        `depth` slots (0: 4) are ours. On the manager's machine only; `write` works from anywhere.
        `lease`: your lease's id, if the stream's region is under a lease.
        """
        folder = self._place.data_folder("a writer")
        from cm.client.writer import Writer  # here: other systems than Linux have no such sockets

        wanted = Open(name, Purpose.WRITE, depth=depth, lease=self._leases.named(lease))
        return self._opened(Writer(folder, wanted, timeout, owner=self))

    def echo(self, length: int, timeout: float | None = 5.0, *, depth: int = 2) -> Writer:
        """Slots of `length` bytes that need no hardware: what is sent is done at once. For measuring."""
        folder = self._place.data_folder("an echo")
        from cm.client.writer import Writer

        wanted = Open("", Purpose.ECHO, depth=depth, length=length)
        return self._opened(Writer(folder, wanted, timeout, owner=self))

    def transfers(self, name: str, timeout: float | None = 5.0, *, lease: str = "") -> Transfers:
        """Transfer arrays of `allocate` to a stream, or from it into them: ``transfers.begin(array)``.

        The stream is nobody else's meanwhile (RequestBusy). On the manager's machine only.
        """
        folder = self._place.data_folder("a transfer")
        from cm.client.writer import Transfers

        wanted = Open(name, Purpose.TRANSFER, lease=self._leases.named(lease))
        return self._opened(Transfers(folder, wanted, timeout, owner=self))

    def _opened(self, writer: _W) -> _W:
        self._sockets.using(writer).open()
        return writer

    def _window(self, wanted: Open, timeout: Limit) -> RegisterWindow:
        self._check_open()
        folder = self._place.data_folder("a window")
        from cm.client.register_window import RegisterWindow  # here: it needs the shim, which only Linux has

        limit = None if wanted.wait and timeout is DEFAULT else seconds(timeout, self.timeout)
        window = self._sockets.using(RegisterWindow(folder, wanted, limit, self._leases, self, wanted.wait))
        window.open()
        return window

    def allocate(
        self, shape: int | Sequence[int], dtype: npt.DTypeLike = "uint8", timeout: Limit = DEFAULT
    ) -> DeviceArray:
        """An array in contiguous memory, for masters in the PL: ``registers["source"] = array.device_address``.

        It is zero at first, and is given back with the last array in it, or with this process. On the manager's
        machine only. Raises InvalidRequest, RequestBusy if the manager gives no more, Timeout.
        """
        self._check_open()
        folder = self._place.data_folder("memory for the PL")
        from cm.client.allocation import allocated  # here: other systems than Linux have no such sockets

        return allocated(folder, shape, dtype, seconds(timeout, self.timeout), self._sockets.using)

    # ---- life -----------------------------------------------------------------------------

    def close(self) -> None:
        """Disconnect, with all streams, writers and events; any later use raises BoardClosed.

        So do calls that wait in other threads. Twice is fine.
        """
        self._sockets.refuse()
        with self._sockets.closing:
            self._sockets.free()
            self._link.close()
            self._close()

    def __enter__(self) -> Board:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _repr_html_(self) -> str:
        """For notebooks: where it is, and its status now."""
        return notebook.paragraph(repr(self)) + ("" if self._sockets.closed else notebook.status(self.status))

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:  # noqa: ARG002 (IPython's)
        """For IPython in a terminal."""
        printer.text(str(self))

    def __str__(self) -> str:
        """Where it is, and its status now, in a few lines; `repr` asks nobody."""
        if self._sockets.closed:
            return repr(self)
        try:
            return f"{self!r}\n{self.status}"
        except CmError as error:
            return f"{self!r}\n{error}"
