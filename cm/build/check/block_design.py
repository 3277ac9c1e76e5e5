# SPDX-License-Identifier: Apache-2.0
"""The generated block design elaborated without Vivado: parameters, clocks of buses, addresses, interrupt lines.

Sources of the ranges: PG021 (AXI DMA, "Customizing and Generating the Core"), PG247 (SmartConnect: 16 ports a side),
PG082 (Zynq-7000: FCLK_CLK 0.1 to 250 MHz), PG201 (Zynq UltraScale+: which ports there are).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any

from cm.build.check.finding import Finding
from cm.build.plan.block_design import ClockPin, DmaCell, Segment
from cm.build.plan.system import System
from cm.schema.problems import KeyPath

_STREAM_WIDTHS = (8, 16, 32, 64, 128, 256, 512, 1024)
_MEMORY_WIDTHS = _STREAM_WIDTHS[2:]
# parameter of an AXI DMA: what it may be
_DMA: Mapping[str, tuple[int, ...]] = {
    "c_include_sg": (0, 1),
    "c_sg_include_stscntrl_strm": (0, 1),
    "c_sg_length_width": tuple(range(8, 27)),
    "c_addr_width": tuple(range(32, 65)),
    "c_include_mm2s": (0, 1),
    "c_include_s2mm": (0, 1),
    "c_include_mm2s_dre": (0, 1),
    "c_include_s2mm_dre": (0, 1),
    "c_m_axis_mm2s_tdata_width": _STREAM_WIDTHS,
    "c_s_axis_s2mm_tdata_width": _STREAM_WIDTHS,
    "c_m_axi_mm2s_data_width": _MEMORY_WIDTHS,
    "c_m_axi_s2mm_data_width": _MEMORY_WIDTHS,
}
PORTS = 16  # of a SmartConnect on either side
_FCLK = re.compile(r"PCW_FPGA\d_PERIPHERAL_FREQMHZ")


def check_block_design(system: System, context: Mapping[str, Any]) -> Iterator[Finding]:
    """Findings of the block design that `context` describes (`cm.build.plan.block_design.context`)."""
    for dma in context["dmas"]:
        yield from _dma(dma)
    yield from _settings(context)
    yield from _buses(context)
    yield from _addresses(system, context["segments"])
    yield from _lines(system, context)


def _dma(dma: DmaCell) -> Iterator[Finding]:
    key: KeyPath = ("regions",)
    values = dict(dma.settings)
    for name, value in values.items():
        allowed = _DMA.get(name)
        if allowed is None:
            yield Finding("PG021", key, f"{dma.cell} has no parameter {name}")
        elif value not in allowed:
            text = f"{allowed[0]} to {allowed[-1]}" if len(allowed) > 8 else ", ".join(map(str, allowed))
            yield Finding("PG021", key, f"{dma.cell}: {name} is {value}", f"it may be {text}")
    stream = next((v for n, v in values.items() if n.endswith("_tdata_width")), 0)
    memory = next((v for n, v in values.items() if re.fullmatch(r"c_m_axi_(mm2s|s2mm)_data_width", n)), 0)
    if isinstance(stream, int) and isinstance(memory, int) and stream > memory:
        message = f"{dma.cell}: the stream has {stream} bits, the way to memory {memory}"
        yield Finding("PG021", key, message, "memory is at least as wide as the stream")


def _settings(context: Mapping[str, Any]) -> Iterator[Finding]:
    for name, value in context["ps_settings"]:
        if _FCLK.fullmatch(name) and not 0.1 <= float(value) <= 250:
            yield Finding("PG082", ("clocks",), f"{name} is {value} MHz", "the PL clocks of Zynq-7000 reach 250 MHz")
    counts = [("control_interconnect", len(context["masters"]))]
    counts += [(memory.cell, len(memory.sources)) for memory in context["memories"]]
    for cell, count in counts:
        if not 1 <= count <= PORTS:
            yield Finding("PG247", ("regions",), f"{cell} has {count} ports", f"a SmartConnect has 1 to {PORTS}")


def _buses(context: Mapping[str, Any]) -> Iterator[Finding]:
    """Each interface port belongs to exactly one clock: else Vivado takes 100 MHz for its rate (BD 41-967, 41-237)."""
    clocks: list[ClockPin] = context["clocks"]
    ports = {f"axis_{dma.name}": dma.clock for dma in context["dmas"]}
    ports |= {port.name: port.clock for port in context["axi_ports"]}
    for name, clock in ports.items():
        owners = [found.name for found in clocks if name in found.buses]
        if owners != [clock]:
            said = ", ".join(owners) or "no clock"
            rule = "BD 41-967" if not owners else "BD 41-237"
            yield Finding(rule, ("clocks",), f"{name} runs on {clock}, but is associated with {said}")


def _addresses(system: System, segments: list[Segment]) -> Iterator[Finding]:
    low, high = system.platform.base, system.platform.base + system.platform.size
    for one in segments:
        window = one.window
        if window.size & (window.size - 1) or window.base % window.size:
            text = f"{window.name}: {window.size:#x} bytes at {window.base:#x}"
            yield Finding("address", ("regions",), text, "a range is a power of two, at a multiple of its size")
        if not low <= window.base <= window.end <= high:
            text = f"{window.name} at {window.base:#x} is outside the window of {system.platform.control_master}"
            yield Finding("address", ("regions",), text, f"it reaches from {low:#x} to {high:#x}")
    for first, second in combinations(segments, 2):
        if first.window.base < second.window.end and second.window.base < first.window.end:
            text = f"{first.window.name} and {second.window.name} overlap at {second.window.base:#x}"
            yield Finding("address", ("regions",), text)


def _lines(system: System, context: Mapping[str, Any]) -> Iterator[Finding]:
    room: dict[str, int] = {}
    for pin, lines, _ in system.platform.irq_pins:
        room[pin] = room.get(pin, 0) + lines
    for group in context["interrupts"]:
        if len(group.sources) > room.get(group.pin, 0):
            text = f"{len(group.sources)} interrupts go to {group.pin}, which has {room.get(group.pin, 0)} lines"
            yield Finding("PG201" if system.platform.ultrascale else "PG082", ("regions",), text)
