# SPDX-License-Identifier: Apache-2.0
"""The slots of an open stream: allocated a few at a time, because a device may take milliseconds for each of them."""

from __future__ import annotations

import os
from contextlib import suppress
from time import monotonic_ns

from cm.daemon.streams.sharing import for_readers, for_writers
from cm.device import AxiDma, DeviceGone, DmaBuffer
from cm.device.data_plane import Plane

AT_ONCE = 8  # slots of one step
_LONG = 200_000  # nanoseconds of a step, after which it ends even if it has fewer


class Slots:
    """Those of one stream. Each is allocated first, and given to the plane later, which hands it to the clients."""

    def __init__(self, plane: Plane, stream: int, dma: AxiDma, length: int, writes: bool) -> None:
        """`stream`: its number in the plane; `length` of a slot in bytes."""
        self._plane, self._stream, self._dma = plane, stream, dma
        self._length = length
        self._writes = writes
        self.made: list[DmaBuffer] = []
        self._given: list[int] = []  # descriptors of the first of them, as clients get them

    def make_some(self, wanted: int) -> None:
        """One step towards `wanted` slots in all. Raises DeviceError; what was made by then stays."""
        began = monotonic_ns()
        for _ in range(min(AT_ONCE, wanted - len(self.made))):
            self.made.append(self._dma.allocate(self._length))
            if monotonic_ns() - began > _LONG:
                return

    def give_some(self, wanted: int) -> bool:
        """One step towards giving `wanted` slots in all to the plane; returns whether it has them now."""
        wanted = min(wanted, len(self.made))
        for slot in self.made[len(self._given) : wanted][:AT_ONCE]:
            self._given.append(for_writers(slot) if self._writes else for_readers(slot))
            self._plane.add_slot(self._stream, self._given[-1], slot.handle)
        return len(self._given) >= wanted

    def take_back_some(self) -> bool:
        """One step towards freeing all slots that the plane has not; returns whether there are none left."""
        spare = len(self.made) - len(self._given)
        for _ in range(min(AT_ONCE, spare)):
            self.made.pop().close()
        return spare <= AT_ONCE

    def close(self) -> None:
        """Release all; the plane has stopped the stream. A channel that was closed before has freed the memory."""
        try:
            with suppress(DeviceGone):
                for slot in self.made:
                    slot.close()
        finally:
            for descriptor in self._given:
                os.close(descriptor)
            self._given.clear()
