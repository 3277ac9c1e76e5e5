# SPDX-License-Identifier: Apache-2.0
"""The generated block design elaborated without Vivado: parameters, clocks of buses, addresses, interrupt lines.

Engines are checked in `cm.design.check.dma`. Sources of the other ranges: PG247 1.0, "Design Parameters"
(SmartConnect: NUM_SI and NUM_MI 1 to 16, NUM_CLKS 1 to 33; "Features": instances may be cascaded),
the customisation of processing_system7 (FCLK_CLK: its table says "0.100000 : 250.000000" MHz; no page of PG082 was
found), PG201 3.4, "Programmable Logic Clocks and Interrupts" (UltraScale+: 16 interrupts), UG585 7.2.3 (Zynq-7000).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any

from cm.design.check.dma import check_dma
from cm.design.plan.block_design import ClockPin, Segment
from cm.design.plan.system import System
from cm.design.project.source_position import Finding

PORTS = 16  # on either side of a SmartConnect
_FCLK = re.compile(r"PCW_FPGA\d_PERIPHERAL_FREQMHZ")


def check_block_design(system: System, context: Mapping[str, Any]) -> Iterator[Finding]:
    """Findings of the block design that `context` describes (`cm.design.plan.block_design.context`)."""
    for dma in context["dmas"]:
        yield from check_dma(dma)
    yield from _settings(context)
    yield from _buses(context)
    yield from _addresses(system, context["segments"])
    yield from _lines(system, context)


def _settings(context: Mapping[str, Any]) -> Iterator[Finding]:
    for name, value in context["ps_settings"]:
        if _FCLK.fullmatch(name) and not 0.1 <= float(value) <= 250:
            yield Finding("PG082", ("clocks",), f"{name} is {value} MHz", "the PL clocks of Zynq-7000 reach 250 MHz")
    counts = [("control_interconnect", len(context["masters"]))]
    counts += [(branch.cell, len(branch.masters)) for branch in context["branches"]]
    counts += [(memory.cell, len(memory.sources)) for memory in context["memories"]]
    for cell, count in counts:
        if not 1 <= count <= PORTS:
            yield Finding("PG247", ("regions",), f"{cell} has {count} ports", f"a SmartConnect has 1 to {PORTS}")


def _buses(context: Mapping[str, Any]) -> Iterator[Finding]:
    """Check that each interface port has exactly one clock: otherwise Vivado assumes 100 MHz (BD 41-967, 41-237)."""
    clocks: list[ClockPin] = context["clocks"]
    ports = {port.name: dma.clock for dma in context["dmas"] for port in dma.ports}
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
