# SPDX-License-Identifier: Apache-2.0
"""The slots of an open stream: allocated a few at a time, because a device may take milliseconds for each of them."""

from __future__ import annotations

import os
from contextlib import suppress
from time import monotonic_ns

from cm.device import AxiDma, DeviceGone, DmaBuffer
from cm.device.data_plane import Plane
from cm.server.streams.sharing import for_readers, for_writers

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
