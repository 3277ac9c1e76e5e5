# SPDX-License-Identifier: Apache-2.0
"""The design behind the nodes of a simulated board: `cm.simulation.software.hardware.logic.Logic` by its RTL."""

from __future__ import annotations

import errno
from collections.abc import Mapping

from cm.schema.model import Direction
from cm.simulation.rtl.bus import RtlBus
from cm.simulation.rtl.design import RtlDesign, StreamEnd
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.process import EXCHANGE, HarnessProcess, Op
from cm.simulation.rtl.running_design import Libraries, RunningDesign
from cm.simulation.rtl.streams import IntakeLink, NoLink, OutletLink
from cm.simulation.software.errors import NodeError, SimError
from cm.simulation.software.hardware.dma import Channel
from cm.simulation.software.hardware.interrupts import InterruptWiring
from cm.simulation.software.hardware.links import Link
from cm.simulation.software.hardware.logic import Logic, LogicParts
from cm.wire.lazy_numpy import np


class RtlInterrupts(InterruptWiring):
    """The lines of the schema at the design's one interrupt, whose status is in its control registers."""

    def __init__(self, parts: LogicParts) -> None:
        super().__init__(parts.fabric, parts.faults)
        self._level = False
        self._wired = list(dict.fromkeys(wired.line for wired in self._wiring.values()))
        for line in self._wired:
            line.follow(lambda: self._level)

    def level(self, level: bool) -> None:
        """The design raises or lowers the line."""
        self._level = level
        for line in self._wired if level else ():
            line.fire()

    def fire(self, name: str) -> bool:  # noqa: ARG002 - nothing but the design raises it
        """False: its inputs cannot be driven from outside."""
        return False

    def of_packets(self, channel: str, region: str | None) -> list[str]:  # noqa: ARG002 - the modules do that
        """None: interrupts with packets come from the module itself."""
        return []


class RtlLogic(Logic):
    """Bus, streams, interrupts and configuration port of a design that runs."""

    def __init__(self, parts: LogicParts, design: RtlDesign, process: HarnessProcess, libraries: Libraries) -> None:
        self._parts, self._design, self._process = parts, design, process
        missing = parts.fabric.regions.keys() - set(design.regions)
        if missing:
            raise SimError(f"the design has no region {', '.join(sorted(missing))}; it has {', '.join(design.regions)}")
        self._running = RunningDesign(parts, design, process, libraries)
        self.bus = RtlBus(self._running, parts.fabric, parts.faults)
        self.interrupts = RtlInterrupts(parts)
        self._running.on_interrupt = self.interrupts.level
        process.memory = self._exchange
        parts.loop.add(process.fileno(), self._hear)

    def links(self, channels: Mapping[str, Channel]) -> dict[str, Link]:
        """Connect each channel to the stream that `cm build` gave its DMA engine."""
        streams = {end.channel: number for number, end in enumerate(self._design.streams) if end.channel}
        named = any(config.streams for config in self._parts.fabric.spec.configs)
        links: dict[str, Link] = {}
        for name, channel in channels.items():
            if name not in streams and named:
                there = ", ".join(sorted(streams)) or "none"
                raise SimError(f"the design has no stream {name}; it has {there} (--build names another design)")
            links[name] = self._link(channel, streams.get(name))
            channel.kick = links[name].kick
        return links

    def configure(self, words: memoryview, failed: bool) -> memoryview:
        """Load through the design's configuration port, a word per clock; returns `words` unchanged if it has none."""
        arena, count = self._process.arena, len(words) // 4
        target = np.frombuffer(arena, np.uint8, 4 * count)
        np.copyto(target, np.frombuffer(words, np.uint8))
        try:
            answer = self._running.ask(Op.CONFIGURE, 0, 0, count, int(failed))
        except RtlError:
            return words[:0]
        if self._design.system.icap is None:
            return words
        return memoryview(bytes(arena[: 4 * min(count, int(answer.b))]))

    def trace(self, folder: str) -> None:
        """FST files: one of the static part, one of each module as often as it is loaded."""
        try:
            answer = self._running.ask(Op.TRACE, text=folder)
        except RtlError as error:
            raise NodeError(errno.EIO, str(error)) from None
        if answer.a:
            raise NodeError(errno.EOPNOTSUPP, answer.text)
        self._running.traced = bool(folder)

    def state(self) -> dict[str, object]:
        """The harness's clocks, and the modules that have ended by themselves."""
        try:
            text = self._running.ask(Op.STATE).text
        except RtlError as error:
            text = str(error)
        return {"rtl": text, "stopped": dict(self._running.stopped)}

    def close(self) -> None:
        """End the harness."""
        self._parts.loop.remove(self._process.fileno())
        self._process.close()

    def _exchange(self, write: bool, address: int, length: int) -> bool:
        """Bytes between the arena and the board's memory, by the address that devices have for it."""
        try:
            there = self._parts.memory.view(address, length)
        except SimError:
            return False
        bytes_at = np.frombuffer(self._process.arena, np.uint8, 2 * length, EXCHANGE)
        if write:
            np.copyto(there, bytes_at[:length], where=bytes_at[length:] != 0)
        else:
            bytes_at[:length] = there
        return True

    def _hear(self) -> None:
        self._running.hear()
        if self._process.ended:
            self._parts.loop.remove(self._process.fileno())

    def _link(self, channel: Channel, stream: int | None) -> Link:
        parts, spec = self._parts, channel.spec
        if stream is None:
            return NoLink(parts.loop, parts.faults)
        common = (parts.loop, parts.faults, self._running, stream, channel)
        if spec.direction is Direction.MM2S:
            return OutletLink(*common)
        sensor = next((number for number, end in enumerate(self._design.streams) if _is_sensor(end, spec.region)), None)
        return IntakeLink(*common) if sensor is None else IntakeLink(*common, parts.camera(channel), sensor)


def _is_sensor(end: StreamEnd, region: str | None) -> bool:
    return end.sends and end.channel is None and end.region == region
