# SPDX-License-Identifier: Apache-2.0
"""Memory that is not coherent: the processor's and the device's view of a buffer, and counts of what joined them.

A buffer's memfd holds the processor's view, then the device's, then a page of counters. What stands for
``DMA_BUF_IOCTL_SYNC`` (``csrc/tests/sim_dma_buf.c``) copies between the views and counts: so code that forgets a call
reads or sends old bytes.
"""

from __future__ import annotations

import mmap
import struct

NAME = "cm-sim-noncoherent"  # of the memfds
_MAGIC = 0x434D53594E430001
_COUNTERS = struct.Struct("<QqQQQQQ")  # magic, holders, starts to read, to write, ends of both, ends without a start
_KEYS = ("read_starts", "write_starts", "read_ends", "write_ends", "unpaired")


class Counters:
    """What was done to one buffer."""

    def __init__(self, fd: int, length: int) -> None:
        """`length` is that of one view."""
        self._page = mmap.mmap(fd, mmap.PAGESIZE, mmap.MAP_SHARED, offset=2 * length)
        _COUNTERS.pack_into(self._page, 0, _MAGIC, *(0,) * 6)

    @property
    def holders(self) -> int:
        """Starts without an end so far."""
        return int(_COUNTERS.unpack_from(self._page)[1])

    def counts(self) -> tuple[int, ...]:
        """In the order of `_KEYS`."""
        return tuple(_COUNTERS.unpack_from(self._page)[2:])


class Syncs:
    """The counters of all buffers that a node ever had."""

    def __init__(self) -> None:
        self._live: list[Counters] = []
        self._before = (0,) * len(_KEYS)
        self.early = 0  # transfers into or out of a buffer that the processor was still using

    def add(self, counters: Counters) -> None:
        """A new buffer."""
        self._live.append(counters)

    def submitted(self, counters: Counters) -> None:
        """The device is given a buffer."""
        self.early += counters.holders > 0

    def forget(self, counters: Counters) -> None:
        """A buffer is given back: from here on only those that still hold it are counted."""
        if counters.holders <= 0:
            self._live.remove(counters)
            self._before = _sum(self._before, counters.counts())

    def totals(self) -> dict[str, int]:
        """What was counted, by name."""
        totals = self._before
        for counters in self._live:
            totals = _sum(totals, counters.counts())
        held = sum(max(0, counters.holders) for counters in self._live)
        return {**dict(zip(_KEYS, totals, strict=True)), "held": held, "early": self.early}


def _sum(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(a + b for a, b in zip(one, other, strict=True))
