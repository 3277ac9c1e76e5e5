# SPDX-License-Identifier: Apache-2.0
"""Registers at their places in windows, the memory of windows, and the regions that answer for them."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
from contextlib import suppress

from cm.schema.model import Memory, Register
from cm.simulation.software.errors import NodeError
from cm.simulation.software.hardware.board_spec import ModuleSpec, RegionSpec, WindowSpec

EMPTY_WORD = 0xDEADBEEF  # what a region without a module reads as
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
_F_SEAL_FUTURE_WRITE = 0x0010  # linux/fcntl.h; the module has it from Python 3.13 on


def shared_to_read(name: str, size: int) -> tuple[int, mmap.mmap]:
    """Memory that clients can map, of this length for as long as they do, and only we can write; its descriptor."""
    fd = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(fd, size)
    ours = mmap.mmap(fd, size)
    with suppress(OSError):  # Linux before 5.1
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, _F_SEAL_FUTURE_WRITE)
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, _SEALS)
    return fd, ours


class Mirror:
    """A window's values, in a form that clients can map (``struct cm_node_mirror``), and whom to ask for each byte.

    A client reads a register there by a load instruction, as it does on a real board. If that would differ from the
    bus's answer, a flag beside the byte sends the client to the bus.
    Pages are allocated when they are written, since a window may be large and hold two registers.
    """

    def __init__(self, name: str, size: int) -> None:
        self.size = -(-max(size, 1) // mmap.PAGESIZE) * mmap.PAGESIZE
        self._fd, self.values = shared_to_read(f"cm-{name}", 2 * self.size)  # and flags behind them

    def ask(self, offset: int, length: int, ask: bool) -> None:
        """Set whether the bus has to be asked for some bytes."""
        at = self.size + offset
        self.values[at : at + length] = (b"\1" if ask else b"\0") * length

    def clear(self) -> None:
        """All values zero again, in the pages that were written."""
        at = 0
        with suppress(OSError):  # there are no more
            while (at := os.lseek(self._fd, at, os.SEEK_DATA)) < self.size:
                end = min(os.lseek(self._fd, at, os.SEEK_HOLE), self.size)
                self.values[at:end] = bytes(end - at)
                at = end

    def descriptor(self) -> int:
        """A descriptor to pass on, the caller's. Raises NodeError if there are no more."""
        try:
            return os.dup(self._fd)
        except OSError as error:
            raise NodeError(error.errno or errno.EMFILE) from error

    def __del__(self) -> None:
        os.close(self._fd)


class Region:
    """A region: the module that runs in it, if any, and whether it is isolated."""

    def __init__(self, spec: RegionSpec) -> None:
        self.spec = spec
        self.name = spec.name
        self.module: ModuleSpec | None = None
        self.loading = False
        self.decoupled = False

    @property
    def running(self) -> bool:
        """Whether a module answers and data flows through it."""
        return self.module is not None and not self.loading


class Cell:
    """A register at its place in a window: the region that answers for it, and its raw value."""

    __slots__ = ("access", "memory", "offset", "region", "register", "width")

    def __init__(self, memory: mmap.mmap, offset: int, register: Register, region: Region | None) -> None:
        self.memory = memory
        self.offset = offset
        self.register = register
        self.access, self.region = register.access, region
        self.width = register.width // 8

    @property
    def value(self) -> int:
        """The value as the hardware sees it, whatever the bus may see."""
        return int.from_bytes(self.memory[self.offset : self.offset + self.width], "little")

    @value.setter
    def value(self, value: int) -> None:
        masked = value & ((1 << 8 * self.width) - 1)
        self.memory[self.offset : self.offset + self.width] = masked.to_bytes(self.width, "little")


class Area:
    """A memory at its place in a window: `end` is the offset behind its last byte."""

    __slots__ = ("access", "end", "memory", "offset", "region")

    def __init__(self, offset: int, memory: Memory, region: Region | None) -> None:
        self.memory = memory
        self.offset, self.end = offset, offset + memory.size
        self.access, self.region = memory.access, region


class Window:
    """The memory of one register window, the cells in it by byte offset, and its areas."""

    def __init__(self, spec: WindowSpec) -> None:
        self.spec = spec
        self.mirror = Mirror(spec.name, spec.size)
        self.memory = self.mirror.values
        self.cells: dict[int, list[Cell]] = {}
        self.areas: list[Area] = []

    def add(self, cell: Cell) -> None:
        """Put a cell at its bytes; several modules of one region may share them."""
        for byte in range(cell.offset, cell.offset + cell.width):
            self.cells.setdefault(byte, []).append(cell)

    def area_at(self, offset: int) -> Area | None:
        """The memory at a byte; of several, in different modes, one whose region answers."""
        found = [area for area in self.areas if area.offset <= offset < area.end]
        return next((area for area in found if answers(area)), found[0] if found else None)

    def cell_at(self, offset: int) -> Cell | None:
        """The cell that answers at a byte: that of the loaded module before others of its region."""
        cells = self.cells.get(offset)
        if not cells:
            return None
        for cell in cells:
            module = cell.region.module if cell.region else None
            if module is not None and same_place(module.registers.get(cell.register.name), cell.register):
                return cell
        return cells[0]


def answers(place: Cell | Area) -> bool:
    """Whether a register or memory is on the bus: its region runs and is not cut off."""
    region = place.region
    return region is None or (region.running and not region.decoupled)


def unanswered(place: Cell | Area, at: int, part: int) -> int:
    """What `part` bytes read as where nothing answers: all ones while the region is loaded or cut off."""
    region = place.region
    if region is not None and not region.loading and not region.decoupled:
        word = EMPTY_WORD.to_bytes(4, "little") * 2
        return int.from_bytes(word[at % 4 : at % 4 + part], "little")
    return (1 << 8 * part) - 1


def same_place(one: Register | None, other: Register) -> bool:
    """Whether two registers are the same bits, whatever their names."""
    return one is not None and one.address == other.address and one.width == other.width
