# SPDX-License-Identifier: Apache-2.0
"""What device trees say of interrupts: those of the processor, those of an AXI INTC, and those that a timer finds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Line:
    """An interrupt: the label of its controller, and its cells."""

    parent: str
    cells: str


@dataclass(frozen=True, slots=True)
class AxiIntc:
    """An AXI INTC (PG099) by the kernel's binding; `edges` has a bit for each input that is an edge."""

    label: str
    base: int
    size: int
    inputs: int
    edges: int
    line: Line  # of its output

    def line_of(self, index: int) -> Line:
        """The interrupt at one of its inputs."""
        return Line(self.label, f"{index} {1 if self.edges >> index & 1 else 4}")


@dataclass(frozen=True, slots=True)
class PolledIntc:
    """The controller of interrupts that are connected to nothing (``fpga-cm,polled-intc``).

    `words`: address of the status register, DMASR, of each channel, by line. An AXI DMA and a VDMA have the same bits
    for what is pending (IOC or FrmCnt, Dly, Err) and for Halted and Idle (PG021, PG020).
    """

    words: tuple[int, ...] = ()
    pending: int = 0x7000
    idle: int = 0x3
    label: str = "cm_polled"

    def line_of(self, word: int) -> Line:
        """The interrupt of a channel by its status register."""
        return Line(self.label, str(self.words.index(word)))
