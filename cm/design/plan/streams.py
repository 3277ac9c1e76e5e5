# SPDX-License-Identifier: Apache-2.0
"""Assigns the streams of regions to DMA channels and engines, with registers and interrupt lines.

The PL has few interrupt lines (16). If there are more channels, neighbours share a line: the kernel's driver requests
shared interrupts (``IRQF_SHARED``), and checks which of its channels raised one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from cm.design.errors import BuildError
from cm.design.hdl.model import Interface, Mode
from cm.design.plan.addresses import Allocator, Window
from cm.design.plan.dma_engines import MC_CHANNELS, Dma, EngineKind
from cm.design.plan.system import RegionPlan, StreamBus
from cm.design.project.model import ConnectionSpec, Project, RegionSpec
from cm.design.project.source_position import fault
from cm.frozen import dataclass, replace
from cm.schema.model import Direction
from cm.schema.problems import KeyPath

MAX_STREAM = 1024  # bits of TDATA that an AXI DMA supports
LONGEST = (1 << 26) - 1  # bytes that its length register can hold
_NAMES = {
    EngineKind.DMA: "AXI DMA (PG021)",
    EngineKind.MCDMA: "AXI MCDMA (PG288)",
    EngineKind.VDMA: "AXI VDMA (PG020)",
}
READBACK = "icap_read"  # the channel from the configuration port to memory
_NOWHERE = Window("", 0, 0)


def dma_width(bits: int) -> int:
    """Bits of the DMA's TDATA for a stream of `bits` (at most `MAX_STREAM`): the next of 8, 16, 32 … 1024."""
    width = 8
    while width < bits:
        width *= 2
    return width


def stream_bus(
    project: Project, region: RegionSpec, interface: Interface, spec: ConnectionSpec, clock: str
) -> StreamBus:
    """Make the stream of an interface, with a channel to which `place` assigns registers and an interrupt line.

    `clock`: on which it runs.
    """
    video = spec.connect == "vdma"
    name = spec.stream or f"{region.name}_{interface.name}"
    key: KeyPath = ("regions", region.name, "interfaces", interface.name)
    who = f"{region.name}.{interface.name}"
    width = interface.data_width
    if width is None:
        message = f"{who} has no TDATA of known width: a DMA needs one"
        raise fault(project.source, key, message, "write connect: external")
    if width > MAX_STREAM:
        message = f"{who} has {width} bits, more than the {MAX_STREAM} that a DMA takes"
        raise fault(project.source, key, message, "write connect: external")
    if video:
        problem = _video_problem(interface, spec, width)
        if problem:
            raise fault(project.source, key, f"{who}: {problem[0]}", problem[1])
    direction = Direction.MM2S if interface.mode is Mode.SLAVE else Direction.S2MM
    bits = max(8, (spec.max_length or LONGEST).bit_length())
    kind = EngineKind.VDMA if video else EngineKind.DMA
    dma = Dma(name, direction, _NOWHERE, -1, clock, width if video else dma_width(width), bits, kind=kind)
    return StreamBus(interface, name, replace(dma, engine=spec.engine or name), spec)


def _video_problem(interface: Interface, spec: ConnectionSpec, width: int) -> tuple[str, str] | None:
    """Return why a VDMA cannot serve an interface and what would be right, or None."""
    needed = ["TLAST", "TUSER"] if interface.mode is Mode.MASTER else ["TLAST"]
    missing = [signal for signal in needed if signal not in interface.ports]
    if missing:
        hint = "TLAST ends each line, TUSER[0] begins each frame (UG934); connect: dma takes packets as frames"
        return f"a VDMA needs {' and '.join(missing)}", hint
    if width % 8:
        return f"{width} bits are not a whole number of bytes, which a VDMA's streams have", "pad the pixels to bytes"
    if spec.shape is None or len(spec.shape) < 2:
        return "a VDMA's frames have lines and columns", "write shape: [lines, columns], with dtype"
    return None


def place(
    project: Project,
    regions: tuple[RegionPlan, ...],
    own: tuple[StreamBus, ...],
    port: tuple[Dma, ...],
    addresses: Allocator,
    lines: int,
) -> tuple[tuple[RegionPlan, ...], tuple[StreamBus, ...], tuple[Dma, ...]]:
    """Return the regions, the switch's streams and the channels of the configuration port, which share an engine, with
    engines, registers and interrupt lines.

    `lines`: how many the PL has; line 0 belongs to the control registers, and no driver may share it.
    """
    buses = [
        _Member(("regions", region.name, "interfaces", bus.interface.name), f"{region.name}.{bus.interface.name}", bus)
        for region in regions
        for bus in region.streams
        if bus.dma
    ]
    buses += [_Member(("switch", "inputs" if b.dma.sends else "outputs", b.name), b.name, b) for b in own if b.dma]
    groups: dict[str, list[_Member]] = {}
    for member in buses:
        groups.setdefault(member.dma.engine, []).append(member)
    if port:
        window = addresses.dma(port[0].name, _NAMES[port[0].kind])
        port = tuple(replace(dma, window=window, line=1 + index) for index, dma in enumerate(port))
    placed: dict[str, Dma] = {}
    for name, members in groups.items():
        kind = _kind(project, name, members)
        window = addresses.dma(name, _NAMES[kind])
        placed |= {dma.name: replace(dma, window=window, kind=kind) for dma in _channels(members, kind)}
    order = [placed[member.bus.name] for member in buses]
    for dma, line in zip(order, _lines(order, 1 + len(port), lines), strict=True):
        placed[dma.name] = replace(dma, line=line)
    found = tuple(replace(region, streams=_with(region.streams, placed)) for region in regions)
    return found, _with(own, placed), port


@dataclass(frozen=True, slots=True)
class _Member:
    """A stream of an engine: its place and its name in the build schema."""

    key: KeyPath
    who: str
    bus: StreamBus

    @property
    def dma(self) -> Dma:
        """Its channel."""
        assert self.bus.dma
        return self.bus.dma


def _with(streams: tuple[StreamBus, ...], placed: Mapping[str, Dma]) -> tuple[StreamBus, ...]:
    return tuple(replace(bus, dma=placed[bus.name]) if bus.dma else bus for bus in streams)


def _kind(project: Project, name: str, members: list[_Member]) -> EngineKind:
    """Return the kind of an engine, or raise a fault if its streams cannot share one."""
    channels = [member.dma for member in members]
    counts = [sum(dma.direction is way for dma in channels) for way in Direction]
    video = {dma.kind is EngineKind.VDMA for dma in channels}
    clocks = sorted({dma.clock for dma in channels})
    shared = max(counts) > 1
    problem: tuple[str, str] | None = None
    if name == "icap":
        problem = "is the configuration port's", "choose another name"
    elif len(video) > 1:
        problem = "has video and other streams", "a VDMA serves video alone: give it an engine of its own"
    elif len(clocks) > 1:
        problem = f"has streams on {' and '.join(clocks)}", "streams of one engine run on one clock"
    elif shared and True in video:
        problem = "has two video streams of one direction", "a VDMA has one channel each way"
    elif max(counts) > MC_CHANNELS:
        problem = f"has {max(counts)} streams of one direction", f"an MCDMA has {MC_CHANNELS} channels each way"
    elif shared:
        problem = _unending(members)
    if problem:
        raise fault(project.source, (*members[-1].key, "engine"), f"engine {name} {problem[0]}", problem[1])
    return EngineKind.VDMA if True in video else EngineKind.MCDMA if shared else EngineKind.DMA


def _unending(members: Iterable[_Member]) -> tuple[str, str] | None:
    """Find a stream without TLAST: streams are interleaved packet by packet, so packets must end."""
    for member in members:
        if not member.dma.sends and "TLAST" not in member.bus.interface.ports:
            hint = "streams of an MCDMA take turns at TLAST: give it one, or an engine of its own"
            return f"has {member.who}, which has no TLAST", hint
    return None


def _channels(members: list[_Member], kind: EngineKind) -> Iterator[Dma]:
    """Number channels by direction; channels that share a port all get the width of the widest."""
    channels = [member.dma for member in members]
    bits = max(dma.length_bits for dma in channels)
    for way in Direction:
        mine = [dma for dma in channels if dma.direction is way]
        width = max((dma.width for dma in mine), default=0)
        for number, dma in enumerate(mine):
            own = dma.width if kind is EngineKind.VDMA else width
            yield replace(dma, number=number, length_bits=bits, width=own)


def crowding(regions: tuple[RegionPlan, ...], own: tuple[StreamBus, ...], lines: int) -> Iterator[str]:
    """Yield a note if channels share interrupt lines."""
    buses = (*(bus for region in regions for bus in region.streams), *own)
    used = [bus.dma.line for bus in buses if bus.dma]
    if len(set(used)) < len(used):
        yield (
            f"{len(used)} DMA channels share {len(set(used))} of the {lines} interrupt lines from the PL: the driver "
            "looks at each channel of a line"
        )


def _lines(channels: list[Dma], first: int, count: int) -> Iterator[int]:
    """Yield a line for each channel, from `first` on; if there are too few, neighbours share one."""
    room = count - first
    if not channels:
        return
    if room < 1:
        raise BuildError(f"no interrupt line is left for DMA channels: {count} come from the PL")
    for index in range(len(channels)):
        yield first + (index if len(channels) <= room else index * room // len(channels))
