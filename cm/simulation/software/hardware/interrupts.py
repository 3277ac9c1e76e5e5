# SPDX-License-Identifier: Apache-2.0
"""Interrupt lines of UIO devices, with the masking of uio_pdrv_genirq."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

from cm.frozen import dataclass
from cm.schema.model import Interrupt
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.register_windows import Cell, Window
from cm.simulation.software.transport.session import Events

_COUNT = struct.Struct("<I")


class Line:
    """One interrupt line: after each interrupt it is masked until a 1 is written.

    An interrupt that comes while it is masked is remembered once, as an edge is; one whose status
    bit is still set when the line is unmasked comes again, as a level does.
    """

    def __init__(self) -> None:
        self.count = 0
        self._masked = True
        self._pending = False
        self._levels: list[Callable[[], bool]] = []
        self._listeners: list[Events] = []

    def add_level(self, stands: Callable[[], bool]) -> None:
        """Add a function that holds the line up as long as it returns true."""
        self._levels.append(stands)

    def follow(self, stands: Callable[[], bool]) -> None:
        """Let nothing but this function hold the line up."""
        self._levels = [stands]

    def listen(self, events: Events) -> None:
        """An open file that gets the counts."""
        self._listeners.append(events)

    def forget(self, events: Events) -> None:
        """The file was closed; the last one leaves the line masked."""
        self._listeners.remove(events)
        if not self._listeners:
            self._masked, self._pending = True, False

    def drop_pending(self) -> None:
        """An interrupt that came while the line was masked is forgotten, as when power is cut."""
        self._pending = False

    def fire(self) -> None:
        """The device raises the line."""
        if self._masked:
            self._pending = True
            return
        self._masked = True
        self.count = (self.count + 1) & 0xFFFFFFFF
        for events in self._listeners:
            events.send(_COUNT.pack(self.count))

    def control(self, word: int) -> None:
        """Handle what was written to the device file: 1 unmasks, 0 masks."""
        self._masked = word == 0
        if self._masked:
            return
        pending, self._pending = self._pending, False
        if pending or any(stands() for stands in self._levels):
            self.fire()


@dataclass(frozen=True, slots=True)
class _Wired:
    """A named interrupt: its line, the status bit that it sets, the region that it belongs to."""

    line: Line
    status: Cell | None
    bit: int | None
    region: str | None


class InterruptWiring:
    """The named interrupts of a board and the lines they are wired to."""

    def __init__(self, fabric: Fabric, faults: Faults) -> None:
        self._faults = faults
        self._fabric = fabric
        self.lines = [Line() for _ in fabric.windows]
        self._wiring: dict[str, _Wired] = {}
        for name, interrupt in fabric.spec.interrupts.items():
            self._wire(name, interrupt)

    def fire(self, name: str) -> bool:
        """Raise an interrupt by name; False if the board has none of that name."""
        wired = self._wiring.get(name)
        if wired is None:
            return False
        if self._faults.take("drop_interrupt", name):
            return True
        if wired.status is not None and wired.bit is not None:
            wired.status.value |= 1 << wired.bit
        wired.line.fire()
        return True

    def packet_done(self, channel: str, region: str | None) -> None:
        """A packet has reached memory.

        Interrupts called …_done in its region's window come, `<channel>_done` wherever it is, and
        `frame_done` if that is in no region.
        """
        for name in self.of_packets(channel, region):
            self.fire(name)

    def of_packets(self, channel: str, region: str | None) -> list[str]:
        """The interrupts that come with each packet."""
        found = []
        for name, wired in self._wiring.items():
            in_region = wired.region is not None and wired.region == region and name.endswith("_done")
            in_static = wired.region is None and name == "frame_done"
            if name == f"{channel}_done" or in_region or in_static:
                found.append(name)
        return found

    def _wire(self, name: str, interrupt: Interrupt) -> None:
        index = self._find(interrupt)
        if index is None:
            return
        line = self.lines[index]
        status = self._fabric.cell(interrupt.status, None) if interrupt.status else None
        if interrupt.status and status is None:
            status = next((c for r in self._fabric.regions if (c := self._fabric.cell(interrupt.status, r))), None)
        if status is not None and interrupt.bit is not None and interrupt.acknowledge:
            line.add_level(partial(_bit_stands, status, interrupt.bit))
        owner = status.region.name if status is not None and status.region else self._owner(index)
        self._wiring[name] = _Wired(line, status, interrupt.bit, owner)

    def _owner(self, index: int) -> str | None:
        """The region that alone has registers in a window."""
        cells = [cell for here in self._fabric.windows[index].cells.values() for cell in here]
        owners = {cell.region.name if cell.region else None for cell in cells}
        return owners.pop() if len(owners) == 1 else None

    def _find(self, interrupt: Interrupt) -> int | None:
        windows: list[Window] = self._fabric.windows
        for index, window in enumerate(windows):
            if interrupt.uio is not None:
                if interrupt.uio in (window.spec.name, f"uio{index}"):
                    return index
            elif interrupt.base_address is None or (window.spec.address <= interrupt.base_address < window.spec.end):
                return index
        return None


def _bit_stands(status: Cell, bit: int) -> bool:
    return bool(status.value >> bit & 1)
