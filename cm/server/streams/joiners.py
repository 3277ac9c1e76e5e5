# SPDX-License-Identifier: Apache-2.0
"""The clients of an open stream: they join when it has slots for them, and it starts when they have joined.

Allocating slots takes time, so iterators do all this in steps, between which the loop serves other requests.
Meanwhile clients may come and go, and the stream may be stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cm.device import DeviceGone, DeviceTimeout
from cm.errors import CmError
from cm.schema.model import Direction, Stream
from cm.server.streams.peer import Peer
from cm.server.streams.shares import RESERVE, NoSlots, share
from cm.server.streams.slots import Slots
from cm.wire.plane_packets import SLOTS_MAX

DEPTH = 4  # frames that a local client may hold by default
_PATIENCE = SLOTS_MAX  # turns for which a client that has joined waits for others before it starts the stream


@dataclass(frozen=True, slots=True)
class _Waits:
    """A client that waits for its slots; `stopped` is called with the errno if the stream ends first."""

    depth: int
    peer: Peer
    stopped: Callable[[int], object]


class Joiners:
    """The clients of one stream, by their numbers in the plane. Used in the loop's thread."""

    def __init__(self, stream: Stream, slots: Slots, attach: Callable[[int, int], bool], each: int) -> None:
        """`attach(client, depth)` attaches in the plane; False: the client has gone. `each`: slots of one process."""
        self.each = each
        self.started = False
        self.closed = False
        self.peers: dict[int, Peer] = {}  # of those that have joined
        self._depths: dict[int, int] = {}  # of the same
        self._waiting: dict[int, _Waits] = {}
        self._told: list[Callable[[Exception | None], None]] = []  # of the start
        self._stream = stream
        self._slots = slots
        self._attach = attach
        self._writes = stream.direction is Direction.MM2S

    # ---- joining --------------------------------------------------------------------

    def join(
        self, client: int, depth: int, peer: Peer | None = None, stopped: Callable[[int], object] = lambda _: None
    ) -> Iterator[None]:
        """Return the steps after which a client of the plane is attached and the stream runs. Raises NoSlots.

        They end early if the client goes or the stream is stopped; `stopped` is then called at once. They raise
        NoSlots and DeviceError. `peer` is None for the daemon itself.
        """
        depth = max(1, min(depth or DEPTH, SLOTS_MAX - RESERVE))
        if peer is not None:
            depth = share(self._stream.name, depth, peer, list(self._held()), self.each)
        self._waiting[client] = _Waits(depth, peer or Peer.ourselves(), stopped)
        return self._steps(client, depth)

    def _held(self) -> Iterator[tuple[Peer, int]]:
        """The slots that processes other than the daemon have, or are waiting for."""
        ours = Peer.ourselves()
        held = [(self.peers[client], depth) for client, depth in self._depths.items()]
        for peer, depth in (*held, *((waits.peer, waits.depth) for waits in self._waiting.values())):
            if peer != ours:
                yield peer, depth

    def _steps(self, client: int, depth: int) -> Iterator[None]:
        try:
            while client in self._waiting and not self._has_room(depth):
                yield
            if client in self._waiting and self._attach(client, depth):
                self._depths[client] = depth
                self.peers[client] = self._waiting[client].peer
        except (CmError, OSError):
            self._waiting.pop(client, None)
            yield from self._take_back()
            raise
        finally:
            self._waiting.pop(client, None)
        yield from self._take_back()
        yield from self.begin()

    def detached(self, client: int) -> None:
        """Forget a client that has gone."""
        self._waiting.pop(client, None)
        self._depths.pop(client, None)
        self.peers.pop(client, None)

    # ---- slots ----------------------------------------------------------------------

    def _wanted(self, depth: int = 0) -> int:
        """How many slots it takes so that the hardware has some left when every reader holds all it may."""
        own = 0 if self._writes else min(self._stream.slots, SLOTS_MAX)
        if self._stream.backpressure and not self._writes:
            return own
        clients = sum(self._depths.values()) + depth
        return max(own, clients + (RESERVE if clients and not self._writes else 0))

    def _has_room(self, depth: int = 0) -> bool:
        """Take a step towards room for one more client; return whether there is room. Raises NoSlots, DeviceError."""
        wanted = self._wanted(depth)
        if wanted > SLOTS_MAX:
            raise NoSlots(
                f"stream {self._stream.name!r} has {len(self.peers)} clients; with one more it needs {wanted} slots"
            )
        if len(self._slots.made) < wanted:
            self._make_some(depth, wanted)
        if len(self._slots.made) < wanted:
            return False
        return self._slots.give_some(wanted) if self.started or self._writes else True

    def _make_some(self, depth: int, wanted: int) -> None:
        try:
            self._slots.make_some(wanted)
        except (DeviceGone, DeviceTimeout):
            raise
        except OSError as error:
            if len(self._slots.made) < self._wanted():  # not even enough for the present clients
                raise
            raise NoSlots(
                f"stream {self._stream.name!r}: no memory for a client of {depth} frames more ({error}); "
                "close others, or ask for a smaller depth"
            ) from error

    def _take_back(self) -> Iterator[None]:
        """Free the slots that were made for a client that did not join, unless others are waiting for slots."""
        while not self.closed and not self._waiting and (self.started or self._writes):
            if self._slots.take_back_some():
                return
            yield

    # ---- start and end --------------------------------------------------------------

    def begin(self) -> Iterator[None]:
        """Return the steps until the stream starts: once the waiting clients have joined, so that they miss no frame.

        The wait for other clients is limited to a number of steps. The steps raise DeviceError.
        """
        while not (self.closed or self.started or self._has_room()):
            yield
        for _ in range(_PATIENCE):
            if self.closed or self.started or not self._waiting:
                break
            yield
        if not (self.closed or self.started):
            self.started = True
            self._tell(None)
        while not self.closed and not self._slots.give_some(self._wanted()):
            yield

    def when_started(self, told: Callable[[Exception | None], None]) -> None:
        """Call `told` with None once the stream has started or been stopped, or with the error that prevents it."""
        if self.started or self.closed:
            told(None)
        else:
            self._told.append(told)

    def fail(self, error: Exception) -> None:
        """Report that the stream cannot start; it will be closed next."""
        self._tell(error)

    def stop(self, error: int) -> None:
        """End the stream, with an errno or 0."""
        self.closed = True
        self._attach = lambda _, __: False  # breaks a cycle that would keep the channel until garbage collection
        waiting, self._waiting = self._waiting, {}
        for waits in waiting.values():
            waits.stopped(error)
        self._tell(None)

    def _tell(self, error: Exception | None) -> None:
        told, self._told = self._told, []
        for tell in told:
            tell(error)
