# SPDX-License-Identifier: Apache-2.0
"""Bus accesses to register windows, with the rules of each register and each region's state."""

from __future__ import annotations

import errno
from collections import defaultdict
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import Protocol

from cm.frozen import dataclass
from cm.schema.model import Access, Decoupler
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.register_windows import Area, Region, Window, answers, unanswered
from cm.simulation.software.transport.protocol import BLOCK_MAX

_WIDTHS = (8, 16, 32, 64)


class Watcher(Protocol):
    """Who sees the words of a static part's blocks."""

    def at(self, window: Window, offset: int) -> object:
        """Something true where a block is."""

    def read(self, window: Window, offset: int) -> int | None:
        """What is read at a word in place of what it holds; None: that."""

    def written(self, window: Window, offset: int, before: int) -> None:
        """A word was written that held `before`."""


class Bus:
    """Reads and writes as the processor makes them."""

    def __init__(
        self,
        fabric: Fabric,
        faults: Faults,
        written: Callable[[Window, int, int], None] = lambda *_: None,
        blocks: Watcher | None = None,
    ) -> None:
        """`written` is told of each write: window, offset, bytes."""
        self._fabric = fabric
        self._written, self._blocks = written, blocks
        self._faults = faults
        self._show = Show(fabric)
        self._decouplers = [
            _DecouplerBit(fabric, region)
            for region in fabric.regions.values()
            if region.spec.decoupler and region.spec.decoupler.size
        ]

    def read(self, window: Window, offset: int, width: int) -> int:
        """The value at an offset.

        All ones while the region is loaded or decoupled, 0xDEADBEEF if no module is loaded, 0 from a write-only
        register.
        """
        length = check_access(window, offset, width)
        if self._blocks is not None and (answer := self._blocks.read(window, offset & ~3)) is not None:
            return answer >> 8 * (offset & 3) & ((1 << width) - 1)
        value = 0
        for at, part in _pieces(window, offset, length):
            value |= _read_piece(window, at, part) << 8 * (at - offset)
        return value

    def write(self, window: Window, offset: int, width: int, value: int) -> None:
        """Write at an offset; lost if the register is read-only or no module answers."""
        length = check_access(window, offset, width)
        told = [at for at in range(offset & ~3, offset + length, 4) if self._blocks and self._blocks.at(window, at)]
        before = [int.from_bytes(window.memory[at : at + 4], "little") for at in told]
        for at, part in _pieces(window, offset, length):
            bits = value >> 8 * (at - offset) & ((1 << 8 * part) - 1)
            self._write_piece(window, at, part, bits)
        for decoupler in self._decouplers:
            decoupler.update(window)
        self._written(window, offset, length)
        for at, word in zip(told, before, strict=True):
            assert self._blocks is not None
            self._blocks.written(window, at, word)

    def read_block(self, window: Window, offset: int, length: int) -> bytes:
        """The bytes that accesses of 32 bits, one after the other, return."""
        check_block(window, offset, length)
        alike, area = _alike(window, offset, length)
        alike = alike and not (self._blocks and self._blocks.at(window, offset))
        if alike and (area is None or (answers(area) and area.access is not Access.WO)):
            return window.memory[offset : offset + length]
        return b"".join(self.read(window, at, 32).to_bytes(4, "little") for at in range(offset, offset + length, 4))

    def write_block(self, window: Window, offset: int, data: bytes) -> None:
        """Accesses of 32 bits, one after the other."""
        check_block(window, offset, len(data))
        alike, area = _alike(window, offset, len(data))
        if not alike or (self._blocks and self._blocks.at(window, offset)):
            for at in range(0, len(data), 4):
                self.write(window, offset + at, 32, int.from_bytes(data[at : at + 4], "little"))
        elif area is None or (answers(area) and area.access is not Access.RO):
            window.memory[offset : offset + len(data)] = data
            for decoupler in self._decouplers:
                decoupler.update(window)

    def _write_piece(self, window: Window, at: int, part: int, bits: int) -> None:
        cell = window.cell_at(at)
        if cell is not None:
            if not answers(cell) or cell.access is Access.RO:
                return
            if self._faults.take("register_stuck", cell.register.name):
                return
            if cell.access is Access.W1C:
                bits = int.from_bytes(window.memory[at : at + part], "little") & ~bits
        elif (area := window.area_at(at)) is not None and (not answers(area) or area.access is Access.RO):
            return
        window.memory[at : at + part] = bits.to_bytes(part, "little")


class _DecouplerBit:
    """Watches what isolates a region: a bit, or all registers that a sequence writes."""

    def __init__(self, fabric: Fabric, region: Region) -> None:
        decoupler = region.spec.decoupler
        assert decoupler is not None
        self._fabric, self._region = fabric, region
        self._window = fabric.window_at(decoupler.base_address + decoupler.offset)
        self._cells = list(self._watched(decoupler)) if self._window else []

    def _watched(self, decoupler: Decoupler) -> Iterator[tuple[int, int, int, int]]:
        """Offset in the window, bytes, mask, and the bits that are set while the region is isolated."""
        assert self._window is not None
        at, length = decoupler.base_address + decoupler.offset - self._window.spec.address, decoupler.width // 8
        bit = 1 << decoupler.bit
        if not decoupler.sequence:
            yield at, length, bit, bit if decoupler.active_high else 0
        for step in decoupler.sequence:
            mask = (1 << decoupler.width) - 1 if step.mask is None else step.mask
            if not step.poll:
                yield at + step.offset, length, mask, step.cut & mask

    def update(self, window: Window) -> None:
        if window is self._window:
            cut = all(
                int.from_bytes(window.memory[at : at + length], "little") & mask == bits
                for at, length, mask, bits in self._cells
            )
            self._fabric.set_decoupled(self._region, cut)


def check_access(window: Window, offset: int, width: int) -> int:
    """Bytes of an access of `width` bits; NodeError (EINVAL) if no bus can make it."""
    if width not in _WIDTHS:
        raise NodeError(errno.EINVAL, f"width {width} is none of 8, 16, 32, 64")
    if offset % (width // 8) or offset + width // 8 > window.spec.size:
        raise NodeError(errno.EINVAL, f"offset {offset:#x} is misaligned or outside the window")
    return width // 8


def check_block(window: Window, offset: int, length: int) -> None:
    """NodeError (EINVAL) unless these bytes are whole words inside the window, and not too many."""
    if not 0 < length <= BLOCK_MAX or offset % 4 or length % 4 or offset + length > window.spec.size:
        raise NodeError(errno.EINVAL, f"{length} bytes at {offset:#x} are misaligned or outside the window")


def _alike(window: Window, offset: int, length: int) -> tuple[bool, Area | None]:
    """Whether one thing covers all these bytes, and the memory if it is one (None: bytes without a name)."""
    over = [area for area in window.areas if area.offset < offset + length and offset < area.end]
    if len(over) > 1 or any(offset <= byte < offset + length for byte in window.cells):
        return False, None
    area = over[0] if over else None
    return area is None or (area.offset <= offset and offset + length <= area.end), area


def _pieces(window: Window, offset: int, length: int) -> list[tuple[int, int]]:
    """Split an access where one register ends and the next begins, and into words where memories are."""
    if window.areas and length > 4:
        return [piece for at in (offset, offset + 4) for piece in _pieces(window, at, 4)]
    if not any(at in window.cells for at in range(offset, offset + length)):
        return [(offset, length)]
    pieces, at = [], offset
    while at < offset + length:
        cell = window.cell_at(at)
        end = cell.offset + cell.width if cell is not None else at + 1
        part = min(end, offset + length) - at
        pieces.append((at, part))
        at += part
    return pieces


def _read_piece(window: Window, at: int, part: int) -> int:
    place = window.cell_at(at) or window.area_at(at)
    if place is not None:
        if not answers(place):
            return unanswered(place, at, part)
        if place.access is Access.WO:
            return 0
    return int.from_bytes(window.memory[at : at + part], "little")


@dataclass(frozen=True, slots=True)
class _Run:
    """Neighbouring bytes that are shown together: those with the same cells, or a memory."""

    window: Window
    start: int
    length: int
    regions: frozenset[Region]
    area: Area | None = None
    shared: bool = False  # others have the same bytes in other modes: the bus decides which it is

    def show(self) -> None:
        """Show the value, or send the client to the bus if nothing answers, or it must not be read."""
        place = self.area or self.window.cell_at(self.start)
        direct = place is None or (answers(place) and place.access is not Access.WO and not self.shared)
        self.window.mirror.ask(self.start, self.length, not direct)


class Show:
    """Keeps the mirrors in step with the regions of a fabric."""

    def __init__(self, fabric: Fabric) -> None:
        self._runs: dict[Region, list[_Run]] = defaultdict(list)
        for run in (run for window in fabric.windows for run in (*_areas(window), *_cells(window))):
            for region in run.regions:
                self._runs[region].append(run)
            run.show()
        fabric.answering = self._update

    def _update(self, region: Region) -> None:
        for run in self._runs[region]:
            run.show()


def _areas(window: Window) -> Iterator[_Run]:
    for area in window.areas:
        shared = any(area.offset <= byte < area.end for byte in window.cells) or any(
            other.offset < area.end and area.offset < other.end for other in window.areas if other is not area
        )
        regions = frozenset({area.region} if area.region else ())
        yield _Run(window, area.offset, area.end - area.offset, regions, area, shared)


def _cells(window: Window) -> Iterator[_Run]:
    """Group the bytes that have the same cells."""
    places = enumerate(sorted(window.cells))
    for _, group in groupby(places, lambda place: (place[1] - place[0], [id(cell) for cell in window.cells[place[1]]])):
        found = [byte for _, byte in group]
        regions = frozenset(cell.region for cell in window.cells[found[0]] if cell.region is not None)
        yield _Run(window, found[0], len(found), regions)
