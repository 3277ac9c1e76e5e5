# SPDX-License-Identifier: Apache-2.0
"""Checks that a stream can carry the frames that a build schema describes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cm.design.plan.dma_engines import Dma, EngineKind
from cm.design.plan.system import RegionPlan, StreamBus, SwitchPlan
from cm.design.project.model import Project
from cm.design.project.source_position import fault
from cm.frozen import replace
from cm.schema.model import ITEM_BYTES
from cm.schema.pictures import format_misfit, pixel_shape
from cm.schema.problems import KeyPath

MAX_LINES, MAX_LINE = (1 << 13) - 1, (1 << 16) - 1  # a VDMA's VSIZE, HSIZE (xaxivdma_hw.h of Xilinx/embeddedsw)


Frame = tuple[Sequence[int] | None, str | None]


def check_frames(project: Project, regions: tuple[RegionPlan, ...], switch: SwitchPlan | None) -> None:
    """Check that frames, of each mode too, are whole beats and no longer than a transfer."""
    for key, who, bus, (shape, dtype) in _frames(project, regions, switch):
        problem = frame_problem(bus, shape, dtype)
        if problem:
            raise fault(project.source, key, f"{who}: {problem[0]}", problem[1])


def _frames(
    project: Project, regions: tuple[RegionPlan, ...], switch: SwitchPlan | None
) -> Iterator[tuple[KeyPath, str, StreamBus, Frame]]:
    """Yield place, name and frame of every stream in every mode."""
    for region in regions:
        for bus in region.streams:
            key: KeyPath = ("regions", region.name, "interfaces", bus.interface.name)
            yield from _of_modes(project, key, f"{region.name}.{bus.interface.name}", bus)
    for bus in switch.streams if switch else ():
        assert bus.dma
        key = ("switch", "inputs" if bus.dma.sends else "outputs", bus.name)
        yield from _of_modes(project, key, bus.name, bus)
    if switch:
        yield from _of_routes(project, switch)


def _of_modes(
    project: Project, key: KeyPath, who: str, bus: StreamBus
) -> Iterator[tuple[KeyPath, str, StreamBus, Frame]]:
    yield (*key, "shape"), who, bus, (bus.spec.shape, bus.spec.dtype)
    for mode in project.modes.values():
        own = mode.streams.get(bus.name)
        if own is not None:
            yield ("modes", mode.name, "streams", bus.name), who, bus, (own.shape or bus.spec.shape, own.dtype)


def _of_routes(project: Project, switch: SwitchPlan) -> Iterator[tuple[KeyPath, str, StreamBus, Frame]]:
    """Yield the frames of the switch's streams, at the regions that a mode routes them to."""
    ends = {bus.name: bus for bus in switch.streams}
    for mode in project.modes.values():
        for sink, source in mode.routes.items():
            stream, other = (sink, switch.sources[source]) if sink in ends else (source, switch.sinks[sink])
            if stream in ends and other.dma is None:
                bus, own = ends[stream], mode.streams.get(stream)
                shape = (own.shape if own else None) or bus.spec.shape
                dtype = (own.dtype if own else None) or bus.spec.dtype
                key: KeyPath = ("modes", mode.name, "routes", sink)
                yield key, f"{stream} at {other.name}", replace(bus, interface=other.interface), (shape, dtype)


def frame_problem(bus: StreamBus, shape: Sequence[int] | None, dtype: str | None) -> tuple[str, str] | None:
    """Return what is wrong with frames of `shape` × `dtype` on this stream and what would be right, or None."""
    if bus.dma is None:
        return None
    if bus.spec.format is not None:
        shape = pixel_shape(tuple(shape) if shape else None, bus.spec.format)
        problem = format_misfit(bus.spec.format, shape, dtype or bus.spec.dtype)
        if problem:
            return problem, "write shape: [rows, columns], and no dtype but uint8"
    if not shape:
        return None
    if bus.dma.kind is EngineKind.VDMA:
        return _video_problem(bus.dma, shape, dtype or bus.spec.dtype)
    size = math.prod(shape) * ITEM_BYTES.get(dtype or bus.spec.dtype, 1)
    text = f"a frame of {'×'.join(map(str, shape))} {dtype or bus.spec.dtype} has {size:_} bytes"
    limit = bus.spec.max_length or (1 << bus.dma.length_bits) - 1
    if size > limit:
        key = "max_length" if bus.spec.max_length else "the DMA's length register"
        return f"{text}, {key} allows {limit:_}", "send it in parts, or make it smaller"
    beat = bus.bytes
    if size % beat and "TKEEP" not in bus.interface.ports:
        hint = f"give {bus.interface.name} a TKEEP, or write a shape of whole beats"
        return f"{text}: not a whole number of beats of {beat} bytes, and there is no TKEEP", hint
    return None


def _video_problem(dma: Dma, shape: Sequence[int], dtype: str) -> tuple[str, str] | None:
    """What a VDMA cannot do: without realignment, lines must be whole words of its memory port (AR 54934)."""
    lines, line = shape[0], math.prod(shape[1:]) * ITEM_BYTES.get(dtype, 1)
    beat, word = dma.width // 8, dma.memory_width // 8
    if len(shape) < 2:
        return "a VDMA's frames have lines and columns", "write shape: [lines, columns], with dtype"
    if lines > MAX_LINES or line > MAX_LINE:
        return f"{lines:_} lines of {line:_} bytes", f"a VDMA takes {MAX_LINES} lines of {MAX_LINE} bytes"
    if line % math.lcm(beat, word):
        return f"a line has {line:_} bytes", f"a VDMA's lines are multiples of {math.lcm(beat, word)} bytes here"
    return None
