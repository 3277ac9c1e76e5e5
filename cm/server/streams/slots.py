# SPDX-License-Identifier: Apache-2.0
"""The slots of an open stream, how many each client may hold, and the clients that join once it has slots for them.

Allocating slots takes time, so iterators do all this in steps, between which the loop serves other requests.
Meanwhile clients may come and go, and the stream may be stopped.
"""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from time import monotonic_ns

from cm.device import AxiDma, DeviceGone, DeviceTimeout, DmaBuffer
from cm.device.data_plane import Plane
from cm.errors import Busy, CmError
from cm.frozen import dataclass
from cm.schema.model import Direction, Stream
from cm.server.streams.client_process import Peer
from cm.wire.plane_packets import SLOTS_MAX

_F_SEAL_FUTURE_WRITE = 0x0010  # linux/fcntl.h; the module has it from Python 3.13 on


def for_readers(slot: DmaBuffer) -> int:
    """Return a descriptor that readers can neither map writable nor reopen so, if it is a memfd (a simulated board).

    A dma-buf takes no seals and cannot be reopened: see docs/security.md.
    """
    if slot.coherent:  # otherwise it has counters beside its content, which readers write to
        _seal(slot.fd, _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL)
    try:
        return os.open(f"/proc/self/fd/{slot.fd}", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return os.dup(slot.fd)


def for_writers(slot: DmaBuffer) -> int:
    """Return a descriptor for writers, none of whom can seal the memory against the others."""
    _seal(slot.fd, fcntl.F_SEAL_SEAL)
    return os.dup(slot.fd)


def _seal(fd: int, seals: int) -> None:
    with suppress(OSError):  # a dma-buf, or Linux before 5.1
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, seals)


RESERVE = 2  # slots that clients can never hold: the hardware fills one while the next waits
_OURS = 4  # for what goes over ZeroMQ
_NEWCOMERS = 16  # for users who hold none yet


class NoSlots(Busy):
    """There are no slots, or there is no DMA memory, for one more reader or writer."""

    code = "no_slots"


def share(stream: str, depth: int, peer: Peer, held: Iterable[tuple[Peer, int]], each: int) -> int:
    """Return how many slots a process gets if it asks for `depth`; `held`: the slots that each client may hold already.

    All processes of a user share `each`. It gets fewer than it asks for rather than none. Raises NoSlots, which says
    who holds them.
    """
    slots = Counter[Peer]()
    for other, count in held:
        slots[other] += count
    own = sum(count for other, count in slots.items() if other.uid == peer.uid)
    left = SLOTS_MAX - RESERVE - _OURS - slots.total() - (_NEWCOMERS if own else 0)
    most = min(each - own, left)
    if most < 1:
        raise NoSlots(
            f"stream {stream!r} has no slots for one more client of pid {peer.pid} ({peer.name}): "
            f"{', '.join(f'pid {p.pid} ({p.name}) holds {n}' for p, n in slots.most_common(4))}, of {SLOTS_MAX}; "
            f"one user gets {each} (limits.slots_each)"
        )
    return min(depth, most)


AT_ONCE = 8  # slots allocated or freed in one step
_LONG = 200_000  # nanoseconds after which a step ends even if it allocated fewer


class Slots:
    """The slots of one stream. Each is allocated first and given to the plane later; the plane hands it to clients."""

    def __init__(self, plane: Plane, stream: int, dma: AxiDma, length: int, writes: bool) -> None:
        """`stream`: its number in the plane; `length`: bytes of one slot."""
        self._plane, self._stream, self._dma = plane, stream, dma
        self._length = length
        self._writes = writes
        self.made: list[DmaBuffer] = []
        self._given: list[int] = []  # the descriptors that clients get, for the slots that the plane has already

    def make_some(self, wanted: int) -> None:
        """Take one step towards `wanted` slots in total. Raises DeviceError; slots made by then stay."""
        began = monotonic_ns()
        for _ in range(min(AT_ONCE, wanted - len(self.made))):
            self.made.append(self._dma.allocate(self._length))
            if monotonic_ns() - began > _LONG:
                return

    def give_some(self, wanted: int) -> bool:
        """Take one step towards giving the plane `wanted` slots in total; return whether it has them now."""
        wanted = min(wanted, len(self.made))
        for slot in self.made[len(self._given) : wanted][:AT_ONCE]:
            self._given.append(for_writers(slot) if self._writes else for_readers(slot))
            self._plane.add_slot(self._stream, self._given[-1], slot.handle)
        return len(self._given) >= wanted

    def take_back_some(self) -> bool:
        """Take one step towards freeing the slots that the plane does not have; return whether all are freed."""
        spare = len(self.made) - len(self._given)
        for _ in range(min(AT_ONCE, spare)):
            self.made.pop().close()
        return spare <= AT_ONCE

    def close(self) -> None:
        """Release all slots, once the plane has stopped the stream. A closed channel has already freed the memory."""
        try:
            with suppress(DeviceGone):
                for slot in self.made:
                    slot.close()
        finally:
            for descriptor in self._given:
                os.close(descriptor)
            self._given.clear()


DEPTH = 4  # frames that a local client may hold by default
_PATIENCE = SLOTS_MAX  # turns for which a client that has joined waits for others before it starts the stream


@dataclass(frozen=True, slots=True)
class _Waits:
    """A client that waits for its slots; `stopped` is called with the errno if the stream ends first."""

    depth: int
    peer: Peer
    stopped: Callable[[int], object]


class SlotHolders:
    """The clients of one stream, by their numbers in the plane. Used in the loop's thread."""

    def __init__(self, stream: Stream, slots: Slots, attach: Callable[[int, int], bool], each: int) -> None:
        """`attach(client, depth)` attaches in the plane; False: the client has gone. `each`: slots of one process."""
        self.each = each
        self.started = False
        self.closed = False
        self.peers: dict[int, Peer] = {}  # of those that have joined
        self._depths: dict[int, int] = {}  # of the same
        self._waiting: dict[int, _Waits] = {}
        self._refused: dict[int, Exception] = {}  # of those that waited when another's attempt failed
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
            if (error := self._refused.pop(client, None)) is not None:
                raise error
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
            if self.started or not self._waiting:  # as of a stream that was stopped
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
        """Report that the stream cannot start; it will be closed next. Those who wait for it are refused too."""
        self._refused, self._waiting = dict.fromkeys(self._waiting, error), {}
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
