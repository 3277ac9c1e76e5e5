# SPDX-License-Identifier: Apache-2.0
"""Addresses in the processor's window to the PL, always the same for the same build schema.

From the platform's base: 16 MiB per clock for the register windows that run on it (the control
registers first), 64 KiB per DMA engine from +64 MiB, and AXI4 windows from +128 MiB.

A range of addresses.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.errors import BuildError
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """A range of addresses: `base` physical, `size` a power of two."""

    name: str
    base: int
    size: int
    doc: str = ""

    @property
    def end(self) -> int:
        """The first address after it."""
        return self.base + self.size


CONTROL_SIZE = 0x1000
DMA_SIZE = 0x10000
DOMAIN_SIZE = 0x0100_0000
DMA_OFFSET = 0x0400_0000
WIDE_OFFSET = 0x0800_0000


class Allocator:
    """Allocates windows, each aligned to its size."""

    def __init__(self, base: int, size: int, clocks: tuple[str, ...]) -> None:
        self._base, self._limit = base, base + size
        self._domains: dict[str, list[Window]] = {clock: [] for clock in clocks}
        self._next = {clock: base + index * DOMAIN_SIZE for index, clock in enumerate(clocks)}
        self._start = dict(self._next)
        self._dma = base + DMA_OFFSET
        self._wide = base + WIDE_OFFSET

    def control(self, clock: str) -> Window:
        """The window of the control registers."""
        return self._in_domain("control", CONTROL_SIZE, clock, "control registers: see cm_control.v")

    def registers(self, name: str, size: int, clock: str) -> Window:
        """An AXI4-Lite window reached on `clock`."""
        return self._in_domain(name, size, clock)

    def dma(self, name: str, doc: str) -> Window:
        """The registers of a DMA engine."""
        window = Window(f"dma_{name}", self._dma, DMA_SIZE, doc)
        self._dma = window.end
        if self._dma > self._base + WIDE_OFFSET:
            raise BuildError("more DMA engines than addresses are reserved for")
        return window

    def wide(self, name: str, size: int) -> Window:
        """A window of a full AXI4 slave."""
        window = Window(name, _align(self._wide, size), size)
        self._wide = window.end
        if window.end > self._limit:
            raise BuildError(f"{name}: {size:#x} bytes do not fit below {self._limit:#x}")
        return window

    def domains(self) -> Iterator[tuple[str, tuple[Window, ...]]]:
        """Clocks with the windows reached on them; clocks without any are left out."""
        return ((clock, tuple(windows)) for clock, windows in self._domains.items() if windows)

    def aperture(self, clock: str) -> Window:
        """The range of a clock."""
        return Window(f"domain_{clock}", self._start[clock], DOMAIN_SIZE)

    def _in_domain(self, name: str, size: int, clock: str, doc: str = "") -> Window:
        window = Window(name, _align(self._next[clock], size), size, doc)
        if window.end > self._start[clock] + DOMAIN_SIZE:
            raise BuildError(f"{name}: the register windows on {clock} exceed {DOMAIN_SIZE >> 20} MiB")
        self._next[clock] = window.end
        self._domains[clock].append(window)
        return window


def _align(address: int, size: int) -> int:
    return (address + size - 1) & -size
