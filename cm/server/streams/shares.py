# SPDX-License-Identifier: Apache-2.0
"""How many slots of a stream a new client may hold: nobody may hold all, and some are reserved for newcomers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from cm.errors import Busy
from cm.server.streams.peer import Peer
from cm.wire.plane_packets import SLOTS_MAX

RESERVE = 2  # slots that clients can never hold: the hardware fills one while the next waits
_OURS = 4  # for what goes over ZeroMQ
_NEWCOMERS = 16  # for processes that hold none yet


class NoSlots(Busy):
    """There are no slots, or there is no DMA memory, for one more reader or writer."""

    code = "no_slots"


def share(stream: str, depth: int, peer: Peer, held: Iterable[tuple[Peer, int]], each: int) -> int:
    """Return how many slots a process gets if it asks for `depth`; `held`: the slots that each client may hold already.

    It gets fewer than it asks for rather than none. Raises NoSlots, which says who holds them.
    """
    slots = Counter[Peer]()
    for other, count in held:
        slots[other] += count
    own = slots[peer]
    left = SLOTS_MAX - RESERVE - _OURS - slots.total() - (_NEWCOMERS if own else 0)
    most = min(each - own, left)
    if most < 1:
        raise NoSlots(
            f"stream {stream!r} has no slots for one more client of pid {peer.pid} ({peer.name}): "
            f"{', '.join(f'pid {p.pid} ({p.name}) holds {n}' for p, n in slots.most_common(4))}, of {SLOTS_MAX}; "
            f"one process gets {each} (limits.slots_each)"
        )
    return min(depth, most)
