# SPDX-License-Identifier: Apache-2.0
"""How much memory processes may have over the data socket: each of them, and all together."""

from __future__ import annotations

from collections import Counter

from cm.daemon.streams.peer import Peer
from cm.errors import Busy

MEMORIES = 64  # of one process: each of them is a descriptor, however small
ALL, EACH = 256 << 20, 192 << 20  # bytes, unless set otherwise


class MemoryBudget:
    """Bytes by process. The loop's thread."""

    def __init__(self, what: str, each: int = EACH, most: int = ALL) -> None:
        """`what`: the memory, for people; `each`, `most`: bytes of one process and of all."""
        self._what = what
        self._each, self._most = each, most
        self._open: dict[int, tuple[Peer, int]] = {}  # by client of the plane

    def renew(self, each: int, most: int) -> None:
        """Other bounds from now on; what was given stays."""
        self._each, self._most = each, most

    def check(self, peer: Peer, length: int) -> None:
        """Raise Busy where a process gets no `length` bytes more."""
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
        """A client of the plane has so many bytes."""
        self._open[client] = peer, length

    def gone(self, client: int) -> None:
        """It has them no more; nothing if it had none."""
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
