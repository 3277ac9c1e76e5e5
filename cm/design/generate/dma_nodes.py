# SPDX-License-Identifier: Apache-2.0
"""What device trees say of DMA engines and platforms, for our own designs and for those of others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cm.design.generate.interrupt_nodes import Line
from cm.design.platforms import Platform

_CHANNELS = 32  # of a node of fpga-cm,dma-client


@dataclass(frozen=True, slots=True)
class Channel:
    """One direction of an engine: `stream` is its name in the runtime schema and in ``/dev/cm_dma``."""

    stream: str
    direction: str  # mm2s or s2mm
    line: Line
    width: int  # bits of a beat
    realigns: bool
    number: int  # the cell of ``dmas``


@dataclass(frozen=True, slots=True)
class ClockInput:
    """A clock input: a phandle with its arguments, or (`rate` in Hz) a clock made in the PL."""

    pin: str
    source: str
    rate: int = 0


@dataclass(frozen=True, slots=True)
class Engine:
    """An axi_dma or axi_vdma."""

    label: str
    kind: str
    base: int
    size: int
    address_bits: int
    length_bits: int
    frames: int  # frame stores of a VDMA
    flushes: bool  # it can recover from a frame of the wrong size
    clocks: tuple[ClockInput, ...]
    channels: tuple[Channel, ...]
    coherent: bool = False

    @property
    def type(self) -> int:
        """The engine's type, as numbered in ``fpga-cm,types``."""
        return 2 if self.kind == "axi_vdma" else 1

    @property
    def groups(self) -> list[tuple[int, tuple[Channel, ...]]]:
        """Channels by direction, with the address of that direction's registers."""
        offsets = {"mm2s": 0, "s2mm": 0x500 if self.kind == "axi_mcdma" else 0x30}
        found = [(self.base + at, tuple(c for c in self.channels if c.direction == d)) for d, at in offsets.items()]
        return [(at, channels) for at, channels in found if channels]


Entry = tuple[Engine, Channel]


@dataclass(frozen=True, slots=True)
class Streams:
    """The channels of one node of streams; the driver knows the largest transfer of each from its engine's node."""

    entries: tuple[Entry, ...]


def streams_of(entries: Sequence[Entry]) -> list[Streams]:
    """Channels in groups as large as the node's binding allows."""
    return [Streams(tuple(entries[n : n + _CHANNELS])) for n in range(0, len(entries), _CHANNELS)]


class Tree:
    """What differs between the platforms' device trees."""

    def __init__(self, platform: Platform) -> None:
        self.zynq = platform.name == "zynq7000"
        self.cells = 1 if self.zynq else 2
        self.intc = "intc" if self.zynq else "gic"
        self.select = "zynq" if self.zynq else "zynqmp"
        self.manager = "devcfg" if self.zynq else "zynqmp_pcap"

    def spi(self, number: int, edge: bool = False) -> Line:
        """A shared interrupt of the processor: IRQ_TYPE_LEVEL_HIGH, or _EDGE_RISING."""
        return Line(self.intc, f"0 {number} {1 if edge else 4}")

    def reg(self, base: int, size: int) -> str:
        """A ``reg`` entry."""
        if self.cells == 1:
            return f"<{base:#010x} {size:#x}>"
        return f"<{base >> 32:#x} {base & 0xFFFFFFFF:#010x} {size >> 32:#x} {size & 0xFFFFFFFF:#x}>"


def pl_clock(zynq: bool, index: int) -> str:
    """The phandle of a PL clock: number 15 and up of Zynq's ``clkc``, 71 and up of ``zynqmp_clk``."""
    return f"&clkc {15 + index}" if zynq else f"&zynqmp_clk {71 + index}"
