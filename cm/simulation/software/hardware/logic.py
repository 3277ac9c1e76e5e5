# SPDX-License-Identifier: Apache-2.0
"""The logic behind the nodes of a board: the software models here, or something that runs the design itself.

A maker gets the parts of the board that are the same for all (`LogicParts`) and gives a `Logic`. The regions of the
fabric say what is loaded where: `Fabric.answering` is called when that changes.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

from cm.frozen import dataclass, field
from cm.loop import Loop
from cm.schema.model import Config, Direction
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.bus import Bus
from cm.simulation.software.hardware.camera import Photo, PhotoReel
from cm.simulation.software.hardware.datapath import Datapath
from cm.simulation.software.hardware.dma import Channel
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.interrupts import InterruptWiring
from cm.simulation.software.hardware.links import Camera, CameraLink, Link, LoopLink, SinkLink, SourceLink
from cm.simulation.software.hardware.models import Models
from cm.simulation.software.hardware.register_windows import Window
from cm.simulation.software.hardware.running_models import RunningModels
from cm.simulation.software.transport.buffers import DmaMemory


class Accesses(Protocol):
    """Reads and writes as the processor makes them; `NodeError` where they fail."""

    def read(self, window: Window, offset: int, width: int) -> int:
        """The value of `width` bits at an offset."""

    def write(self, window: Window, offset: int, width: int, value: int) -> None:
        """Write `width` bits at an offset."""

    def read_block(self, window: Window, offset: int, length: int) -> bytes:
        """The bytes that accesses of 32 bits, one after the other, return."""

    def write_block(self, window: Window, offset: int, data: bytes) -> None:
        """Accesses of 32 bits, one after the other."""


class Logic:
    """The programmable logic as nodes see it: what it has not, and what nothing shows, by default."""

    bus: Accesses
    interrupts: InterruptWiring

    def links(self, channels: Mapping[str, Channel]) -> dict[str, Link]:
        """The other end of each channel's stream; called once."""
        raise NotImplementedError

    def know(self, images: Mapping[str, Config], digest: Callable[[memoryview], str]) -> None:
        """The images of static parts by what `digest` makes of one that was loaded; nothing here needs them."""

    def configure(self, words: memoryview, failed: bool) -> memoryview:  # noqa: ARG002 - nothing here shows it
        """The words that reach the configuration logic when ICAP gets these; the flag: whether it signals an error."""
        return words

    def trace(self, folder: str) -> None:  # noqa: ARG002 - none
        """Write traces to files in a folder; an empty name ends that. `NodeError` if it is not possible."""
        raise NodeError(errno.EOPNOTSUPP, "models in software have no signals to trace")

    def state(self) -> dict[str, object]:
        """State in addition to that of every board."""
        return {}

    def close(self) -> None:
        """End what runs beside us."""


@dataclass(frozen=True, slots=True)
class Options:
    """What can be set about a board besides its hardware."""

    photos: Sequence[Photo] | None  # None: those of the package
    pcap_rate: float  # bytes per second; 0: at once
    icap_rate: float | None = None  # bytes per second; None: word width times clock; 0: at once
    hold: int = 150  # frames for which a photo stays
    rate: float | None = None  # frames per second of every camera; None: as the schema says; 0: as fast as possible
    memory: int = 512 << 20  # bytes of DMA memory
    vdma: Collection[str] = ()  # channels that are a VDMA's
    simple: Mapping[str, tuple[int, bool]] = field(default_factory=dict)  # bits of the length register, and if blind
    coherent: bool = True  # memory: if not, every access of the processor has to be synchronised


@dataclass(frozen=True, slots=True)
class LogicParts:
    """What a maker of logic is given."""

    loop: Loop
    fabric: Fabric
    faults: Faults
    models: Models
    memory: DmaMemory
    options: Options

    def camera(self, channel: Channel) -> Camera:
        """What gives the frames of a camera's channel."""
        rate = channel.spec.rate if self.options.rate is None else self.options.rate
        return Camera(PhotoReel(self.options.photos, self.options.hold), rate, channel.spec.shape)


MakeLogic = Callable[[LogicParts], Logic]


class SoftwareLogic(Logic):
    """Modules as functions on frames, registers as memory."""

    def __init__(self, parts: LogicParts) -> None:
        self._parts = parts
        self.interrupts = InterruptWiring(parts.fabric, parts.faults)
        self._running = RunningModels(parts.loop, parts.fabric, parts.models, self.interrupts, parts.memory)
        self.bus = Bus(parts.fabric, parts.faults, self._running.written, self._running.blocks)

    def know(self, images: Mapping[str, Config], digest: Callable[[memoryview], str]) -> None:
        """The images of static parts, whose blocks have models."""
        self._running.blocks.know(images, digest)

    def links(self, channels: Mapping[str, Channel]) -> dict[str, Link]:
        """A camera, a loop through a region, or an end that consumes, by what the channel says."""
        links: dict[str, Link] = {}
        for name, channel in channels.items():
            spec = channel.spec
            if name in links:
                continue
            if spec.is_camera:
                links[name] = CameraLink(*self._common, self._path(channel), channel, self._parts.camera(channel))
            elif spec.partner is None and spec.direction is Direction.S2MM:
                links[name] = SourceLink(*self._common, self._path(channel), channel)
            elif spec.partner is None:
                links[name] = SinkLink(*self._common, self._path(channel), channel)
            else:
                links |= self._loop_link(channels, name, spec.partner)
            channel.kick = links[name].kick
        self._running.links, self._running.channels = links, channels
        return links

    @property
    def _common(self) -> tuple[Loop, Faults, InterruptWiring]:
        return self._parts.loop, self._parts.faults, self.interrupts

    def _path(self, channel: Channel) -> Datapath:
        return Datapath(self._parts.fabric, self._parts.models, self._running, channel.spec.region, channel.spec.shape)

    def _loop_link(self, channels: Mapping[str, Channel], one: str, other: str) -> dict[str, Link]:
        source, sink = channels[one], channels[other]
        if source.spec.direction is Direction.S2MM:
            source, sink = sink, source
        link = LoopLink(*self._common, self._path(source), source, sink)
        source.kick = sink.kick = link.kick
        return {one: link, other: link}
