# SPDX-License-Identifier: Apache-2.0
"""Keeps the mirrors of the windows up to date: which bytes can be read there, and which need a bus access."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cm.schema.model import Access
from cm.sim.hardware.cells import Area, Cell, Region, Window, answers
from cm.sim.hardware.fabric import Fabric


class _Block:
    """A memory, which is shown as a whole."""

    def __init__(self, window: Window, area: Area) -> None:
        self._window, self._area = window, area
        # If other things have the same bytes in other modes, the bus decides which it is.
        self._shared = any(area.offset <= byte < area.end for byte in window.cells) or any(
            other.offset < area.end and area.offset < other.end for other in window.areas if other is not area
        )

    def show(self) -> None:
        """As a run."""
        area = self._area
        direct = answers(area) and area.access is not Access.WO and not self._shared
        self._window.mirror.ask(area.offset, area.end - area.offset, not direct)


@dataclass(frozen=True, slots=True)
class _Run:
    """Neighbouring bytes with the same cells."""

    window: Window
    start: int
    length: int
    cells: Sequence[Cell]

    def show(self) -> None:
        """Show the value, or send the client to the bus if nothing answers, or the register must not be read."""
        cell = self.window.cell_at(self.start)
        direct = cell is None or (answers(cell) and cell.register.access is not Access.WO)
        self.window.mirror.ask(self.start, self.length, not direct)


class Show:
    """Keeps the mirrors in step with the regions of a fabric."""

    def __init__(self, fabric: Fabric) -> None:
        self._runs: dict[Region, list[_Run | _Block]] = defaultdict(list)
        for window in fabric.windows:
            for area in window.areas:
                block = _Block(window, area)
                if area.region is not None:
                    self._runs[area.region].append(block)
                block.show()
        for run in (run for window in fabric.windows for run in _runs(window)):
            for region in {cell.region for cell in run.cells if cell.region is not None}:
                self._runs[region].append(run)
            run.show()
        fabric.answering = self._update

    def _update(self, region: Region) -> None:
        for run in self._runs[region]:
            run.show()


def _runs(window: Window) -> Iterator[_Run]:
    """Group the bytes that have the same cells."""
    start, length = 0, 0
    cells: Sequence[Cell] = ()
    for byte in sorted(window.cells):
        if byte == start + length and window.cells[byte] == cells:
            length += 1
            continue
        if length:
            yield _Run(window, start, length, cells)
        start, length, cells = byte, 1, window.cells[byte]
    if length:
        yield _Run(window, start, length, cells)
