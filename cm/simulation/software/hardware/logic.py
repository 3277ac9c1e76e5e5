# SPDX-License-Identifier: Apache-2.0
"""The logic behind the nodes of a board: the software models here, or something that runs the design itself.

A maker gets the parts of the board that are the same for all (`LogicParts`) and gives a `Logic`. The regions of the
fabric say what is loaded where: `Fabric.answering` is called when that changes.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from cm.frozen import dataclass
from cm.loop import Loop
from cm.schema.model import Direction
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.bus import Bus
from cm.simulation.software.hardware.camera import Photo, PhotoReel
from cm.simulation.software.hardware.datapath import Datapath
from cm.simulation.software.hardware.dma import Channel
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.interrupts import InterruptWiring, Line
from cm.simulation.software.hardware.links import CameraLink, Link, LoopLink, SinkLink
from cm.simulation.software.hardware.models import Models
from cm.simulation.software.hardware.register_windows import Window
from cm.simulation.software.hardware.running import RunningModels
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


class InterruptLines(Protocol):
    """The lines of the UIO devices, in the order of the windows."""

    @property
    def lines(self) -> Sequence[Line]:
        """One for each window."""

    def fire(self, name: str) -> bool:
        """Raise an interrupt by name; False if none of that name can be raised from here."""


class Logic(Protocol):
    """The programmable logic as nodes see it."""

    @property
    def bus(self) -> Accesses:
        """The way to the registers."""

    @property
    def interrupts(self) -> InterruptLines:
        """The lines to the processor."""

    def links(self, channels: Mapping[str, Channel]) -> dict[str, Link]:
        """The other end of each channel's stream; called once."""

    def configure(self, words: memoryview, failed: bool) -> memoryview:
        """The words that reach the configuration logic when ICAP gets these; the flag: whether it signals an error."""

    def trace(self, folder: str) -> None:
        """Write traces to files in a folder; an empty name ends that. `NodeError` if it is not possible."""

    def cover(self) -> None:
        """Write which lines of the HDL have run, if that is counted."""

    def mark(self, text: str) -> None:
        """Show a text in the trace that is written, if one is."""

    def state(self) -> dict[str, object]:
        """State in addition to that of every board."""

    def close(self) -> None:
        """End what runs beside us."""


@dataclass(frozen=True, slots=True)
class LogicParts:
    """What a maker of logic is given. `rate`: frames per second of every camera; None: as the schema says."""

    loop: Loop
    fabric: Fabric
    faults: Faults
    models: Models
    photos: Sequence[Photo] | None
    hold: int
    rate: float | None
    seed: int
    memory: DmaMemory


MakeLogic = Callable[[LogicParts], Logic]


class SoftwareLogic:
    """Modules as functions on frames, registers as memory."""

    def __init__(self, parts: LogicParts) -> None:
        self._parts = parts
        self.interrupts = InterruptWiring(parts.fabric, parts.faults)
        self._running = RunningModels(parts.loop, parts.fabric, parts.models, self.interrupts, parts.memory)
        self.bus = Bus(parts.fabric, parts.faults, self._running.written)

    def links(self, channels: Mapping[str, Channel]) -> dict[str, Link]:
        """A camera, a loop through a region, or an end that consumes, by what the channel says."""
        links: dict[str, Link] = {}
        for name, channel in channels.items():
            spec = channel.spec
            if name in links:
                continue
            if spec.is_camera:
                links[name] = self._camera(channel)
            elif spec.partner is None:
                links[name] = SinkLink(*self._common, self._path(channel), channel)
            else:
                links |= self._loop_link(channels, name, spec.partner)
            channel.kick = links[name].kick
        self._running.links = links
        return links

    def configure(self, words: memoryview, failed: bool) -> memoryview:  # noqa: ARG002 - nothing here shows it
        """The same words: nothing is in between."""
        return words

    def cover(self) -> None:
        """Nothing is counted."""

    def trace(self, folder: str) -> None:  # noqa: ARG002 - none
        """Models have no signals."""
        raise NodeError(errno.EOPNOTSUPP, "models in software have no signals to trace")

    def mark(self, text: str) -> None:
        """Nothing shows it."""

    def state(self) -> dict[str, object]:
        """Nothing more."""
        return {}

    def close(self) -> None:
        """Links end by themselves."""

    @property
    def _common(self) -> tuple[Loop, Faults, InterruptWiring]:
        return self._parts.loop, self._parts.faults, self.interrupts

    def _path(self, channel: Channel) -> Datapath:
        return Datapath(self._parts.fabric, self._parts.models, self._running, channel.spec.region, channel.spec.shape)

    def _camera(self, channel: Channel) -> CameraLink:
        reel = PhotoReel(self._parts.photos, self._parts.hold)
        rate = channel.spec.rate if self._parts.rate is None else self._parts.rate
        return CameraLink(*self._common, self._path(channel), channel, reel, rate)

    def _loop_link(self, channels: Mapping[str, Channel], one: str, other: str) -> dict[str, Link]:
        source, sink = channels[one], channels[other]
        if source.spec.direction is Direction.S2MM:
            source, sink = sink, source
        link = LoopLink(*self._common, self._path(source), source, sink)
        source.kick = sink.kick = link.kick
        return {one: link, other: link}
