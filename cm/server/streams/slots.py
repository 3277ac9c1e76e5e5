# SPDX-License-Identifier: Apache-2.0
"""The memory of an open stream: slots, a few of which are allocated, given to the plane or freed in each step."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from time import monotonic_ns

from cm.device import AxiDma, DeviceGone, DmaBuffer
from cm.device.data_plane import Plane

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

    @property
    def given(self) -> int:
        """How many of them the plane has."""
        return len(self._given)

    def give_some(self, wanted: int) -> None:
        """Take one step towards giving the plane `wanted` slots in total."""
        for slot in self.made[len(self._given) : wanted][:AT_ONCE]:
            self._given.append(for_writers(slot) if self._writes else for_readers(slot))
            self._plane.add_slot(self._stream, self._given[-1], slot.handle)

    def free_some(self) -> None:
        """Take one step towards freeing the slots that the plane does not have."""
        for _ in range(min(AT_ONCE, len(self.made) - len(self._given))):
            self.made.pop().close()

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
