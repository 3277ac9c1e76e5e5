# SPDX-License-Identifier: Apache-2.0
"""The local data plane: a C thread between DMA channels and clients on sockets (csrc/plane.h)."""

from __future__ import annotations

import errno
from collections.abc import Callable
from functools import partial

from cm.device.axidma import AxiDma
from cm.device.errors import device_error
from cm.device.native import plane as native
from cm.device.native.plane import ClientCounts as ClientCounts
from cm.device.native.plane import StreamCounts as StreamCounts
from cm.frozen import dataclass

ECHO_DEPTH = 64  # transfers under way where there is no channel


@dataclass(frozen=True, slots=True)
class StreamSetup:
    """How a stream runs: lengths in bytes; `lines` is 0 if a frame is not a video frame; `period_ns` 0: no limit.

    `lent`: how many transfers of its client's own memory at once, 0: it has slots. `address`: of memory to lend.
    """

    write: bool
    length: int
    backpressure: bool = False
    cyclic: bool = False
    lines: int = 0
    line_bytes: int = 0
    stride: int = 0
    period_ns: int = 0
    lent: int = 0
    address: int = 0


@dataclass(frozen=True, slots=True)
class ClientGone:
    """A client hung up, or broke the rules (`error` is an errno then)."""

    client: int
    error: int


@dataclass(frozen=True, slots=True)
class ClientLeaves:
    """A reader wants no more frames; it goes when it has given back those that it holds."""

    client: int


@dataclass(frozen=True, slots=True)
class StreamLost:
    """A stream's device failed; stop it."""

    stream: int
    error: int


class Plane:
    """Streams and clients by number. Any thread; `close()` ends it, twice is fine."""

    def __init__(self) -> None:
        """Start the thread."""
        self._handle = native.new()
        self._open = True
        # Registers were written and hold the new values: frames that begin from now on have this generation.
        self.wrote: Callable[[int], None] = partial(native.wrote, self._handle)

    def fileno(self) -> int:
        """Return the descriptor that polls readable when an event waits."""
        return native.event_fd(self._handle)

    def event(self) -> ClientGone | ClientLeaves | StreamLost | None:
        """Take the next event, if there is one."""
        raw = native.take(self._handle)
        if raw is None:
            return None
        if raw.kind == native.CLIENT_LEAVES:
            return ClientLeaves(raw.id)
        return (ClientGone if raw.kind == native.CLIENT_GONE else StreamLost)(raw.id, raw.error)

    def start(self, dma: AxiDma | None, setup: StreamSetup) -> int:
        """Begin a stream over an open channel, which must stay open until `stop`; None: an echo."""
        raw = native.Setup(
            setup.write,
            setup.backpressure,
            setup.cyclic,
            dma.info.queue_depth if dma else ECHO_DEPTH,
            setup.length,
            setup.lines,
            setup.line_bytes,
            setup.stride,
            setup.period_ns,
            setup.lent,
            setup.address,
        )
        return native.start(self._handle, None if dma is None else dma.shim_handle, raw)

    def add_slot(self, stream: int, fd: int, handle: int = 0) -> int:
        """Give a stream memory; `fd`, which clients get, must stay open until `stop`."""
        return native.add_slot(self._handle, stream, fd, handle)

    def stop(self, stream: int, error: int = 0) -> None:
        """End a stream: no transfer is under way when it returns; its clients are told."""
        native.stop(self._handle, stream, error)

    def adopt(self, fd: int) -> int:
        """Take over a connected socket's descriptor; returns the client's number."""
        return native.adopt(self._handle, fd)

    def attach(self, client: int, stream: int, depth: int, geometry: bytes) -> bool:
        """Attach a client to a stream; False if it has gone. Raises DeviceError for too few slots."""
        try:
            native.attach(self._handle, client, stream, depth, geometry)
        except OSError as error:
            if error.errno == errno.ENOENT:
                return False
            raise device_error(error, "attach a client to", f"stream {stream}") from error
        return True

    def tell(self, stream: int, packet: bytes) -> None:
        """Send a packet to all clients of a stream."""
        native.tell(self._handle, stream, packet)

    def settle(self) -> None:
        """Handle what clients have sent by now: events report all that hung up before the call."""
        native.settle(self._handle)

    def drop(self, client: int) -> None:
        """Hang up on a client; fine if it has gone."""
        try:
            native.drop(self._handle, client)
        except FileNotFoundError:
            return

    def counts(self, stream: int) -> StreamCounts:
        """The counters of a stream."""
        return native.stats(self._handle, stream)

    def client_counts(self, client: int) -> ClientCounts | None:
        """The counters of one client; None if it has gone."""
        try:
            return native.client_stats(self._handle, client)
        except FileNotFoundError:
            return None

    def close(self) -> None:
        """End the thread, hang up on all, stop all streams."""
        if self._open:
            self._open = False
            native.close(self._handle)
