# SPDX-License-Identifier: Apache-2.0
"""A .hwh → static registers, interrupts, streams, clocks of a runtime schema."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from cm.design.collect.foreign_dma import stream_names
from cm.formats import hwh
from cm.formats.registers import RegisterBank, identifier
from cm.schema.model import Clock, Direction, Memory, Register, Stream


@dataclass(frozen=True, slots=True)
class Handoff:
    """A block design as the vendor's tool describes it; a `partial` one has no processor, and relative addresses."""

    name: str
    design: hwh.Hwh

    @property
    def partial(self) -> bool:
        """The description of a module, not of the whole design."""
        return hwh.processor(self.design) is None

    @property
    def device(self) -> str:
        """The device as a runtime schema names it: ``xc7z020``."""
        name = self.design.device.lower()
        return name if name.startswith("x") else f"xc{name}"


def read_handoff(path: Path, source: str = "") -> Handoff:
    """A .hwh file; raises `cm.formats.hwh.HwhError`, which names it `source` if it came from an archive."""
    return Handoff(path.stem, hwh.read(path, source))


def registers(
    design: hwh.Hwh, notes: list[str], base: int = 0, region: str | None = None
) -> tuple[dict[str, Register], dict[str, Memory]]:
    """Registers of every window, called ``<instance>_<register>``, and memories; `notes` gets what no schema can have.

    A window of which no registers are described is a memory of words, as is block RAM.

    Of a whole design, those of regions and of DMA engines, which belong to the kernel's drivers, are left out. Of the
    module in a `region`, addresses below `base` are relative, and moved there.
    """
    driven = set() if region else {channel.instance for channel in hwh.dma_channels(design)}
    bank = RegisterBank(notes)
    for window in hwh.windows(design):
        instance = design.modules.get(window.instance)
        if instance is None or instance.region or window.instance in driven:
            continue
        blocks = hwh.registers(instance, window.interface)
        if not blocks and len(instance.registers) == 1:
            (blocks,) = instance.registers.values()
        place = window.base if window.base >= base else base + window.base
        if blocks:
            bank.add(identifier(instance.name), place, window.size, blocks, region)
        else:
            bank.add("", place, window.size, hwh.raw(instance, window), region)
    # the hardware may change them, so they are never verified after a write
    return {name: replace(register, volatile=True) for name, register in bank.registers.items()}, bank.memories


def streams(design: hwh.Hwh) -> dict[str, Stream]:
    """One stream per DMA channel; the name is the engine's if it has only one channel."""
    channels = hwh.dma_channels(design)
    names = stream_names(channels, design)
    found: dict[str, Stream] = {}
    for channel in channels:
        name = names[channel]
        doc = f"{channel.kind} {channel.instance}" + (f", {channel.width} bits a beat" if channel.width else "")
        if channel.limits:
            doc += f"; {channel.limits}"
        most = channel.longest if channel.limits else None
        found[name] = Stream(name, name, Direction(channel.direction), doc=doc, max_length=most)
    return found


def limits(design: hwh.Hwh) -> list[str]:
    """Say for each stream what its engine cannot do, if it has no scatter/gather."""
    channels = hwh.dma_channels(design)
    names = stream_names(channels, design)
    return [f"stream {names[c]}: {c.instance} has {c.limits}" for c in channels if c.limits]


def clocks(design: hwh.Hwh) -> dict[str, Clock]:
    """PL clocks."""
    return {clock.name: Clock(clock.name, clock.rate) for clock in hwh.clocks(design)}
