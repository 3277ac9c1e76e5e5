# SPDX-License-Identifier: Apache-2.0
"""Cells of DMA engines in the block design: parameters, clock pins, ports of their streams.

Every parameter is one that published block designs set. What a core derives from its connections is left to it: a
VDMA refuses the width of its S2MM stream (BD 41-737), and an MCDMA takes it from its port.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.plan.dma_engines import Dma, Engine, EngineKind
from cm.design.plan.system import System
from cm.frozen import dataclass
from cm.schema.model import Direction

Setting = tuple[str, object]
FRAME_STORES = 3
MC_GROUP_BITS = 16


@dataclass(frozen=True, slots=True)
class StreamPort:
    """A port of the block design for a stream pin of an engine; `mode`: as seen from outside."""

    name: str
    mode: str
    pin: str
    settings: tuple[Setting, ...]


@dataclass(frozen=True, slots=True)
class DmaCell:
    """A DMA engine's cell; `clock` is the project's name of the clock on all its pins."""

    name: str
    cell: str
    ip: EngineKind
    doc: str
    clock: str
    clock_pin: str
    clock_pins: tuple[str, ...]
    settings: tuple[Setting, ...]
    ports: tuple[StreamPort, ...]
    memory_pins: tuple[str, ...]


def dma_cell(system: System, engine: Engine, clock_pin: str) -> DmaCell:
    """The cell of an engine; `clock_pin` is the processing system's pin of its clock."""
    settings = {EngineKind.DMA: _dma, EngineKind.MCDMA: _mcdma, EngineKind.VDMA: _vdma}[engine.kind]
    memory = [f"M_AXI_{way.value.upper()}" for way in engine.directions]
    return DmaCell(
        name=engine.name,
        cell=f"dma_{engine.name}",
        ip=engine.kind,
        doc=_doc(engine),
        clock=engine.clock,
        clock_pin=clock_pin,
        clock_pins=tuple(clock_pins(engine)),
        settings=tuple(settings(engine, system.platform.address_bits)),
        ports=tuple(_port(system, engine, way) for way in engine.directions),
        memory_pins=tuple((["M_AXI_SG"] if engine.kind.scattered else []) + memory),
    )


def clock_pins(engine: Engine) -> Iterator[str]:
    """The clock inputs that an engine's core has."""
    yield "s_axi_lite_aclk"
    if engine.kind is EngineKind.MCDMA:
        yield "s_axi_aclk"
        return
    if engine.kind is EngineKind.DMA:
        yield "m_axi_sg_aclk"
    for way in engine.directions:
        yield f"m_axi_{way.value}_aclk"
        if engine.kind is EngineKind.VDMA:
            yield f"{_stream(way)}_aclk"


def _doc(engine: Engine) -> str:
    ways = {Direction.MM2S: "memory to stream", Direction.S2MM: "stream to memory"}
    listed = ", ".join(f"{channel.name}: {ways[channel.direction]}" for channel in engine.channels)
    return f"{listed}, registers at {engine.window.base:#010x}"


def _stream(way: Direction) -> str:
    return "m_axis_mm2s" if way is Direction.MM2S else "s_axis_s2mm"


def _widest(engine: Engine, way: Direction) -> Dma:
    return max(engine.of(way), key=lambda channel: channel.width)


def _dma(engine: Engine, address_bits: int) -> Iterator[Setting]:
    yield "c_include_sg", 1
    yield "c_sg_include_stscntrl_strm", 0
    yield "c_sg_length_width", engine.length_bits
    yield "c_addr_width", address_bits
    yield from _included(engine)
    for way in engine.directions:
        channel = _widest(engine, way)
        yield f"c_{_stream(way)}_tdata_width", channel.width
        yield f"c_m_axi_{way.value}_data_width", channel.memory_width
        yield f"c_include_{way.value}_dre", 0


def _mcdma(engine: Engine, address_bits: int) -> Iterator[Setting]:
    yield "c_sg_include_stscntrl_strm", 0
    yield "c_sg_length_width", engine.length_bits
    yield "c_addr_width", address_bits
    yield from _included(engine)
    for way in engine.directions:
        count, channel = len(engine.of(way)), _widest(engine, way)
        yield f"c_num_{way.value}_channels", count
        yield f"c_group1_{way.value}", f"{(1 << count) - 1:0{MC_GROUP_BITS}b}"  # one group of all channels
        if way is Direction.MM2S:
            yield "c_m_axis_mm2s_tdata_width", channel.width
        yield f"c_m_axi_{way.value}_data_width", channel.memory_width


def _vdma(engine: Engine, address_bits: int) -> Iterator[Setting]:
    yield "c_include_sg", 0
    yield "c_addr_width", address_bits
    yield "c_num_fstores", FRAME_STORES
    yield from _included(engine)
    for way in engine.directions:
        channel = _widest(engine, way)
        if way is Direction.MM2S:
            yield "c_m_axis_mm2s_tdata_width", channel.width
        yield f"c_m_axi_{way.value}_data_width", channel.memory_width
        yield f"c_{way.value}_genlock_mode", 0
        yield f"c_{way.value}_linebuffer_depth", 2048
    if Direction.S2MM in engine.directions:
        yield "c_use_s2mm_fsync", 2  # a frame begins at TUSER[0]


def _included(engine: Engine) -> Iterator[Setting]:
    for way in (Direction.MM2S, Direction.S2MM):
        yield f"c_include_{way.value}", int(way in engine.directions)


def _port(system: System, engine: Engine, way: Direction) -> StreamPort:
    mode = "Master" if way is Direction.MM2S else "Slave"
    settings = tuple(_port_settings(system, engine)) if way is Direction.S2MM else ()
    return StreamPort(engine.port(way), mode, _stream(way).upper(), settings)


def _port_settings(system: System, engine: Engine) -> Iterator[Setting]:
    """Settings of an input port, which cannot derive them; the core takes its widths from there."""
    names = {channel.name for channel in engine.of(Direction.S2MM)}
    buses = [bus for bus in system.streams if bus.dma and bus.dma.name in names]
    keep = engine.channels[0].shared or any(bus.converted or "TKEEP" in bus.interface.ports for bus in buses)
    yield "TDATA_NUM_BYTES", _widest(engine, Direction.S2MM).width // 8
    yield "HAS_TLAST", 1
    yield "HAS_TKEEP", int(keep)
    if engine.kind is EngineKind.MCDMA:
        yield "TDEST_WIDTH", 4
    if engine.kind is EngineKind.VDMA:
        yield "TUSER_WIDTH", 1
