# SPDX-License-Identifier: Apache-2.0
"""Register accesses as transactions on the design's AXI4-Lite buses."""

from __future__ import annotations

import errno

from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.process import Op
from cm.simulation.rtl.running_design import SLOT, RunningDesign
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.bus import check_access, check_block
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.register_windows import Window

_WHY = {
    errno.EFAULT: "no slave has that address (DECERR)",
    errno.EIO: "the slave refuses it (SLVERR), as a region does that is cut off",
    errno.ETIMEDOUT: "nothing answers: on a board the processor would hang",
}


class RtlBus:
    """Reads and writes as the processor makes them: words of 32 bits, narrower writes by byte strobes."""

    def __init__(self, running: RunningDesign, fabric: Fabric, faults: Faults) -> None:
        self._running, self._fabric, self._faults = running, fabric, faults
        for window in fabric.windows:
            window.mirror.ask(0, window.spec.size, True)  # every read is one

    def read(self, window: Window, offset: int, width: int) -> int:
        """The value of `width` bits at an offset; 64 bits are two accesses. `NodeError`: as the bus answers."""
        check_access(window, offset, width)
        at, length = offset & ~3, 8 if width == 64 else 4
        value = int.from_bytes(self._read(window, at, length), "little")
        return value >> 8 * (offset - at) & ((1 << width) - 1)

    def write(self, window: Window, offset: int, width: int, value: int) -> None:
        """Write `width` bits at an offset; 64 bits are two accesses."""
        check_access(window, offset, width)
        if self._stuck(window, offset):
            return
        at, length = offset & ~3, 8 if width == 64 else 4
        shift = offset - at
        strobes = 0xF if width >= 32 else ((1 << width // 8) - 1) << shift
        self._write(window, at, (value << 8 * shift).to_bytes(length, "little"), strobes)

    def read_block(self, window: Window, offset: int, length: int) -> bytes:
        """The bytes that accesses of 32 bits, one after the other, return."""
        check_block(window, offset, length)
        return self._read(window, offset, length)

    def write_block(self, window: Window, offset: int, data: bytes) -> None:
        """Accesses of 32 bits, one after the other."""
        check_block(window, offset, len(data))
        self._write(window, offset, data, 0xF)

    def _read(self, window: Window, offset: int, length: int) -> bytes:
        self._access(Op.READ, window, offset, length, 0)
        return self._running.process.arena[:length]

    def _write(self, window: Window, offset: int, data: bytes, strobes: int) -> None:
        assert len(data) <= SLOT
        self._running.process.arena[: len(data)] = data
        self._access(Op.WRITE, window, offset, len(data), strobes)
        self._note_decoupling(window, offset, data)

    def _access(self, op: Op, window: Window, offset: int, length: int, strobes: int) -> None:
        try:
            answer = self._running.ask(op, window.spec.address + offset, length // 4, 0, strobes)
        except RtlError as error:
            raise NodeError(errno.EIO, str(error)) from None
        if answer.a:
            raise NodeError(int(answer.a), _WHY.get(int(answer.a), answer.text))

    def _stuck(self, window: Window, offset: int) -> bool:
        cell = window.cell_at(offset)
        return cell is not None and self._faults.take("register_stuck", cell.register.name) is not None

    def _note_decoupling(self, window: Window, offset: int, data: bytes) -> None:
        """Note which regions are isolated, for the board's state."""
        for region in self._fabric.regions.values():
            decoupler = region.spec.decoupler
            if decoupler is None or not decoupler.size:
                continue
            at = decoupler.base_address + decoupler.offset - window.spec.address - offset
            if 0 <= at <= len(data) - 4:
                bit = int.from_bytes(data[at : at + 4], "little") >> decoupler.bit & 1
                region.decoupled = bool(bit) == decoupler.active_high
                self._running.mark(f"{region.name}: {'cut off' if region.decoupled else 'connected'}")
