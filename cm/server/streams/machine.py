# SPDX-License-Identifier: Apache-2.0
"""One stream: its phase, its clients, and the next step towards what they need. No socket, no device, no clock.

`cm.server.streams.running` takes the steps, one in each turn of the loop, and reports those that failed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from cm.device import DeviceGone, DeviceTimeout
from cm.errors import Busy
from cm.frozen import dataclass
from cm.schema.model import Direction, Stream
from cm.server.client_process import Peer
from cm.wire.plane_packets import SLOTS_MAX

RESERVE = 2  # slots that clients can never hold: the hardware fills one while the next waits
DEPTH = 4  # frames that a local client may hold by default
_OURS = 4  # slots for what goes over ZeroMQ
_NEWCOMERS = 16  # for users who hold none yet
_PATIENCE = SLOTS_MAX  # steps for which a client that has joined waits for others before the stream starts


class StreamPhase(str, Enum):
    """The phase that a stream is in."""

    CLOSED = "closed"  # it is not needed
    RESTING = "resting"  # it could not be opened, and is tried again after a while
    OPENING = "opening"  # its channel is open; the hardware and the first clients get their slots
    RUNNING = "running"
    HELD = "held"  # stopped while its region changes


class StreamEvent(str, Enum):
    """An event in a stream's life."""

    OPEN = "open"
    START = "start"
    CLOSE = "close"
    FAIL = "fail"
    RETRY = "retry"
    HOLD = "hold"
    RELEASE = "release"


_P, _E = StreamPhase, StreamEvent
OPEN_PHASES = (_P.OPENING, _P.RUNNING)

TRANSITIONS: Mapping[tuple[StreamPhase, StreamEvent], StreamPhase] = MappingProxyType(
    {
        (_P.CLOSED, _E.OPEN): _P.OPENING,
        (_P.RESTING, _E.OPEN): _P.OPENING,
        (_P.OPENING, _E.START): _P.RUNNING,
        (_P.OPENING, _E.CLOSE): _P.CLOSED,
        (_P.RUNNING, _E.CLOSE): _P.CLOSED,
        (_P.CLOSED, _E.FAIL): _P.RESTING,
        (_P.OPENING, _E.FAIL): _P.RESTING,
        (_P.RUNNING, _E.FAIL): _P.RESTING,
        (_P.RESTING, _E.RETRY): _P.CLOSED,
        (_P.CLOSED, _E.HOLD): _P.HELD,
        (_P.RESTING, _E.HOLD): _P.HELD,
        (_P.HELD, _E.HOLD): _P.HELD,
        (_P.HELD, _E.RELEASE): _P.CLOSED,
    }
)


class IllegalTransition(RuntimeError):
    """An event that the table does not allow: a defect of the daemon, never of a request."""


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


@dataclass(slots=True, eq=False)
class Member:
    """A client of a stream, which it stays while the stream is closed; but for the daemon's own (`ours`).

    `stopped` is to be called with an errno, or 0, if the stream ends while the client waits.
    """

    client: int
    depth: int
    peer: Peer
    ours: bool
    stopped: Callable[[int], object]
    lends: bool  # it transfers memory of its own, and needs no slots
    joined: bool = False  # it has its slots; else it waits for them, or for the stream
    leaving: bool = False  # it only holds frames yet
    settled: bool = False  # its first wait is over
    error: Exception | None = None  # why it was refused
    check: Callable[[Stream], object] = lambda _: None  # raises what forbids it the stream as it is now


class StepKind(Enum):
    """What is to be done with a stream."""

    ALLOCATE = "allocate"  # some slots more
    GIVE = "give"  # some of them to the plane, which passes them to clients and hardware
    ATTACH = "attach"  # a client
    START = "start"
    FREE = "free"  # some slots that the plane does not have


class Step(NamedTuple):
    """A step: towards so many slots altogether, and for whom; None: for the hardware, or for those that are there."""

    kind: StepKind
    slots: int
    member: Member | None = None


class StreamMachine:
    """Its phase, and its members by their numbers in the plane."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.phase = StreamPhase.CLOSED
        self.members: dict[int, Member] = {}
        self.rest_until = 0.0  # CLOCK_MONOTONIC, where it could not be opened
        self.silent = False  # for its channel did not answer
        self.made = self.given = 0  # slots that there are, and those that the plane has
        self._stream: Stream  # as it was opened
        self._writes = False
        self.lent = False  # it was opened for the memory of a client
        self._patience = 0

    def after(self, event: StreamEvent) -> None:
        """Apply an event. Raises IllegalTransition, and then changes nothing."""
        before, phase = self.phase, TRANSITIONS.get((self.phase, event))
        if phase is None:
            raise IllegalTransition(f"stream {self.name!r}, which is {before.value}, cannot {event.value}")
        self.phase = phase
        if before in OPEN_PHASES and phase not in OPEN_PHASES:
            self.made = self.given = 0
            self.members = {m.client: m for m in self.members.values() if not (m.ours or m.leaving)}
            for member in self.members.values():
                member.joined, member.settled = False, True

    def open(self, stream: Stream) -> None:
        """Its channel was opened; members that waited for that join again."""
        self.after(_E.OPEN)
        self._stream, self._writes, self._patience = stream, stream.direction is Direction.MM2S, _PATIENCE
        self.lent = self.is_lent

    # ---- members ----------------------------------------------------------------------

    def join(
        self,
        client: int,
        depth: int,
        peer: Peer | None = None,
        each: int = SLOTS_MAX,
        stopped: Callable[[int], object] = lambda _: None,
        lends: bool = False,
    ) -> Member:
        """Add a client that wants `depth` slots (0: four), or `lends` its memory.

        A user gets `each` slots at most. Raises NoSlots, and Busy where clients of the other kind are there.
        """
        for other in self.members.values():
            if other.lends or (lends and not (other.ours or other.leaving)):
                raise Busy(
                    f"stream {self.name!r} is in use by pid {other.peer.pid} ({other.peer.name}): transfers of a "
                    "client's own memory have it alone"
                )
        depth = max(1, min(depth or DEPTH, SLOTS_MAX - RESERVE))
        if peer is not None:
            held = [(member.peer, member.depth) for member in self.members.values() if not member.ours]
            depth = share(self.name, depth, peer, held, each)
        whose = peer or Peer.ourselves()
        member = self.members[client] = Member(client, depth, whose, peer is None, stopped, lends)
        return member

    def left(self, client: int) -> None:
        """A client has hung up, or was hung up on."""
        member = self.members.pop(client, None)
        if member is not None:
            member.settled = True

    def leaves(self, client: int) -> None:
        """A client keeps the slots that it holds, but the stream no longer runs for its sake."""
        if client in self.members:
            self.members[client].leaving = self.members[client].settled = True

    @property
    def waiting(self) -> list[Member]:
        """The members that have no slots yet."""
        return [member for member in self.members.values() if not (member.joined or member.leaving)]

    @property
    def joined(self) -> dict[int, Peer]:
        """The clients that have theirs."""
        return {member.client: member.peer for member in self.members.values() if member.joined}

    @property
    def is_lent(self) -> bool:
        """Whether it shall transfer the memory of a client."""
        return any(member.lends for member in self.members.values())

    @property
    def is_used(self) -> bool:
        """Whether clients on this machine want frames, or want to write them."""
        return any(not (member.ours or member.leaving) for member in self.members.values())

    # ---- what is to be done -----------------------------------------------------------

    def wanted(self, depth: int = 0) -> int:
        """How many slots it takes so that the hardware has some left when every reader holds all it may."""
        if self.lent:
            return 0
        own = 0 if self._writes else min(self._stream.slots, SLOTS_MAX)
        if self._stream.backpressure and not self._writes:
            return own
        clients = sum([member.depth for member in self.members.values() if member.joined]) + depth
        return min(SLOTS_MAX, max(own, clients + (RESERVE if clients and not self._writes else 0)))

    def next(self) -> Step | None:
        """The next step; None while all is as it should be.

        Who needs fewer slots comes first. A stream starts once those that wait have theirs, so that they miss no frame,
        but waits only for so long.
        """
        if self.phase not in OPEN_PHASES:
            return None
        running, waiting, wanted = self.phase is _P.RUNNING, self.waiting, self.wanted()
        if running and self.given < wanted <= self.made:
            return Step(StepKind.GIVE, wanted)
        if waiting and (running or self._patience > 0):
            member = min(waiting, key=lambda member: member.depth)
            wanted = self.wanted(member.depth)
            if self.made < wanted:
                return Step(StepKind.ALLOCATE, wanted, member)
            if self.given < wanted and (running or self._writes):
                return Step(StepKind.GIVE, wanted, member)
            return Step(StepKind.ATTACH, wanted, member)
        if self.made < wanted:
            return Step(StepKind.ALLOCATE, wanted)
        if not running:
            return Step(StepKind.START, wanted)
        return Step(StepKind.FREE, self.given) if self.made > self.given else None

    def took(self, step: Step, made: int, given: int) -> None:
        """A step was taken; there are so many slots now, and the plane has so many of them."""
        self.made, self.given = made, given
        if step.kind is StepKind.START:
            self.after(_E.START)
        elif step.kind is StepKind.ATTACH and step.member is not None:
            step.member.joined = step.member.settled = True
        elif self.phase is _P.OPENING and self.joined:
            self._patience -= 1

    def failed(self, step: Step, error: Exception, made: int) -> list[Member]:
        """A step could not be taken: return the members that are refused for it, each with its error.

        If it is for want of memory for one of several members, or the stream runs, only that member is. Otherwise the
        stream fails.
        """
        self.made, member, reason = made, step.member, error
        alone = member is None or (self.phase is _P.OPENING and len(self.members) == 1)
        lost = isinstance(error, (DeviceGone, DeviceTimeout))
        if member is not None and not lost and made >= self.wanted():  # enough for those that are there
            if step.kind is StepKind.ALLOCATE:
                reason = NoSlots(
                    f"stream {self.name!r}: no memory for a client of {member.depth} frames more ({error}); "
                    "close others, or ask for a smaller depth"
                )
                reason.__cause__ = error
        else:
            alone = alone or self.phase is _P.OPENING
        refused = self.waiting if alone or member is None else [member]
        for one in refused:
            one.error = reason
            self.left(one.client)
        if alone:
            self.after(_E.FAIL)
        return refused
