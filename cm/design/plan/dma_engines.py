# SPDX-License-Identifier: Apache-2.0
"""DMA engines and their channels: every stream has a channel, and streams may share an engine.

The kind of an engine follows from its channels: at most one in each direction is an AXI DMA (PG021), more are an
AXI MCDMA (PG288, 16 each way), and video streams have an AXI VDMA (PG020).
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

from cm.design.plan.addresses import Window
from cm.frozen import dataclass
from cm.schema.model import Direction

MC_CHANNELS = 16  # of an MCDMA, in each direction


class EngineKind(str, Enum):
    """The IP of an engine, by its name in Vivado's catalogue."""

    DMA = "axi_dma"
    MCDMA = "axi_mcdma"
    VDMA = "axi_vdma"

    @property
    def guide(self) -> str:
        """Its product guide."""
        return {"axi_dma": "PG021", "axi_mcdma": "PG288", "axi_vdma": "PG020"}[self.value]

    @property
    def scattered(self) -> bool:
        """Whether it fetches descriptors, through a separate memory port."""
        return self is not EngineKind.VDMA


@dataclass(frozen=True, slots=True)
class Dma:
    """A DMA channel; `line`: its interrupt line of the PL, which several channels may share.

    `number` counts the channels of one direction of an engine: an MCDMA distinguishes them by it, in TDEST.
    """

    name: str
    direction: Direction
    window: Window
    line: int
    clock: str
    width: int  # bits of TDATA on the static side: 8 << n, or any number of bytes for a VDMA
    length_bits: int = 26
    engine: str = ""  # empty: not shared
    kind: EngineKind = EngineKind.DMA
    number: int = 0

    @property
    def sends(self) -> bool:
        """Whether it moves data from memory to the stream."""
        return self.direction is Direction.MM2S

    @property
    def memory_width(self) -> int:
        """Bits of its memory port: a power of two, at least 32, and no narrower than the stream."""
        return max(32, 1 << (self.width - 1).bit_length())

    @property
    def shared(self) -> bool:
        """Whether its stream shares the engine's only port of this direction."""
        return self.kind is EngineKind.MCDMA

    @property
    def cell(self) -> int:
        """The kernel's number of the channel: the MCDMA driver counts S2MM from 16; other engines have 0 and 1."""
        first = MC_CHANNELS if self.shared else 1
        return self.number if self.sends else first + self.number

    @property
    def interrupt_pin(self) -> str:
        """The pin of its interrupt on the cell."""
        channel = f"_ch{self.number + 1}" if self.shared else ""
        return f"{self.direction.value}{channel}_introut"


@dataclass(frozen=True, slots=True)
class Engine:
    """A DMA engine: one register window, one or more channels on one clock."""

    name: str
    channels: tuple[Dma, ...]

    @property
    def kind(self) -> EngineKind:
        """Which IP it is."""
        return self.channels[0].kind

    @property
    def window(self) -> Window:
        """Its registers."""
        return self.channels[0].window

    @property
    def clock(self) -> str:
        """The clock on which all of it runs."""
        return self.channels[0].clock

    @property
    def length_bits(self) -> int:
        """Bits of the length register."""
        return max(channel.length_bits for channel in self.channels)

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The directions that it has, MM2S first."""
        return tuple(way for way in (Direction.MM2S, Direction.S2MM) if self.of(way))

    def of(self, direction: Direction) -> tuple[Dma, ...]:
        """Its channels of one direction, by number."""
        return tuple(channel for channel in self.channels if channel.direction is direction)

    @property
    def masters(self) -> int:
        """The number of its memory ports."""
        return len(self.directions) + self.kind.scattered

    def port(self, direction: Direction) -> str:
        """The block design's port of its stream: a channel's own name, or the engine's where channels share it."""
        return (
            f"axis_{self.name}_{direction.value}" if self.channels[0].shared else f"axis_{self.of(direction)[0].name}"
        )


def engines_of(channels: Iterable[Dma]) -> tuple[Engine, ...]:
    """The engines of channels, in the order of their first ones."""
    found: dict[str, list[Dma]] = {}
    for channel in channels:
        found.setdefault(channel.engine or channel.name, []).append(channel)
    return tuple(Engine(name, tuple(members)) for name, members in found.items())
