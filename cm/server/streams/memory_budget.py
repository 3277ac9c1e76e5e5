# SPDX-License-Identifier: Apache-2.0
"""Limits on the memory that processes hold through the data socket: for each process, and in total."""

from __future__ import annotations

from collections import Counter

from cm.errors import Busy
from cm.server.limits import USUAL
from cm.server.streams.peer import Peer

MEMORIES = 64  # allocations of one process: each takes a file descriptor, however small it is


class MemoryBudget:
    """Counts bytes by process. Used in the loop's thread only."""

    def __init__(self, what: str, each: int = USUAL.memory_each_bytes, most: int = USUAL.memory_bytes) -> None:
        """`what`: how messages call the memory; `each`, `most`: limits in bytes, of one process and in total."""
        self._what = what
        self._each, self._most = each, most
        self._open: dict[int, tuple[Peer, int]] = {}  # by client of the plane

    def renew(self, each: int, most: int) -> None:
        """Set other limits; memory already allocated stays."""
        self._each, self._most = each, most

    def check(self, peer: Peer, length: int) -> None:
        """Raise Busy if a process may not have another `length` bytes."""
        held = [size for who, size in self._open.values() if who.pid == peer.pid]
        used = sum(size for _, size in self._open.values())
        if used + length > self._most:
            raise Busy(f"{self._what} is {self._most >> 20} MiB together; {used} bytes are taken ({self._holders()})")
        if sum(held) + length > self._each:
            raise Busy(
                f"{self._what} is {self._each >> 20} MiB for one process (limits.memory_each_mib); "
                f"pid {peer.pid} ({peer.name}) has {sum(held)} bytes"
            )
        if len(held) >= MEMORIES:
            raise Busy(f"pid {peer.pid} ({peer.name}) has {MEMORIES} pieces of {self._what}: no process gets more")

    def took(self, client: int, peer: Peer, length: int) -> None:
        """Record that a client of the plane has `length` bytes."""
        self._open[client] = peer, length

    def gone(self, client: int) -> None:
        """Record that a client has gone; it may have held nothing."""
        self._open.pop(client, None)

    def held(self) -> Counter[Peer]:
        """Bytes of each process."""
        found: Counter[Peer] = Counter()
        for peer, size in self._open.values():
            found[peer] += size
        return found

    def _holders(self) -> str:
        most = self.held().most_common(4)
        return ", ".join(f"pid {peer.pid} ({peer.name}) has {size}" for peer, size in most) or "by nobody"
