# SPDX-License-Identifier: Apache-2.0
"""Reports what the open tools cannot do before they are run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from cm.design.errors import BuildError
from cm.design.openflow.netlists import MEMORY_PORTS, WIDEST, halves
from cm.design.plan.dma_engines import Dma, EngineKind
from cm.design.plan.floorplan import rectangle
from cm.design.plan.system import Implementation, RegionPlan, System
from cm.design.project.model import in_libraries
from cm.design.project.source_position import OPEN_FLOW, Finding
from cm.formats.bitstream.geometry import geometry_of
from cm.schema.model import Direction

DEVICES = ("xc7z010", "xc7z020")
# Cells that yosys emits and nextpnr places, and that have been tried in a region or in a static part
CELLS = re.compile(
    r"LUT[1-6]|FD[RSCP]E(_1)?|CARRY4|MUXF[78]|INV|SRL16E|SRLC16E|SRLC32E|RAM(32|64|128|256)\w*|RAMB(18|36)E1|DSP48E1|BUFG|PS7|"
    r"[IO]BUF|GND|VCC|\$scopeinfo"
)

_WAYS = {Direction.MM2S: "from memory", Direction.S2MM: "to memory"}


def check_open(system: System) -> list[Finding]:
    """Findings about what in a system the open flow cannot do."""
    found = [Finding(OPEN_FLOW, key, message, hint) for key, message, hint in _system(system)]
    for region in system.regions:
        found += [
            Finding(OPEN_FLOW, ("regions", region.name, *key), message, hint) for key, message, hint in _region(region)
        ]
    for one in system.implementations:
        key = ("modules", one.module.name)
        found += [Finding(OPEN_FLOW, key, message, hint) for message, hint in _module(one)]
    return found


def refuse_open(system: System) -> None:
    """Raise BuildError with everything that the open flow cannot do."""
    told = [finding.text(system.project.source) for finding in check_open(system)]
    if told:
        raise BuildError("the open tools cannot build this design:\n  " + "\n  ".join(told))


def check_cells(netlist: dict[str, Any], top: str, what: str, dsp: bool = False) -> None:
    """Raise BuildError for synthesised cells that have not been tried, or for DSP48 without `dsp`."""
    cells = netlist["modules"][top]["cells"]
    wrong = {name: cell["type"] for name, cell in cells.items() if not CELLS.fullmatch(cell["type"])}
    if wrong:
        few = _few(wrong)
        raise BuildError(
            f"{what}: {len(wrong)} cells that the open flow has not been tried with: {few}; it takes look-up tables, "
            "flip-flops, carry chains, wide multiplexers, shift registers, distributed and block RAM, DSP48E1"
        )
    multipliers = {name: cell["type"] for name, cell in cells.items() if cell["type"] == "DSP48E1"}
    if multipliers and not dsp:
        raise BuildError(
            f"{what}: {_few(multipliers)}, and its region has none: add their column's DSP48 to its pblock"
        )


def _few(cells: dict[str, str]) -> str:
    return ", ".join(f"{name} is a {kind}" for name, kind in sorted(cells.items())[:3])


def _system(system: System) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    project = system.project
    if system.device not in DEVICES or geometry_of(system.device) is None:
        yield ("project",), f"{system.device}: nextpnr has no data of it", f"it works for {', '.join(DEVICES)}"
    yield from _clocks(system)
    if system.icap is not None:
        hint = "loader: fpga_manager"
        yield ("regions",), "ICAPE2 has not been tried with nextpnr", hint
    for bus in system.switch.streams if system.switch else ():
        if bus.dma is not None:
            yield from ((("switch",), f"{bus.name}: {message}", hint) for message, hint in _stream(bus.dma))
    for way, channels in halves(system).items():
        if len(channels) > MEMORY_PORTS:
            message = f"{len(channels)} streams {_WAYS[way]}: the processing system has {MEMORY_PORTS} ports for them"
            yield ("regions",), message, "connect: external, or none"
    spec = project.static
    if in_libraries(spec.libraries) or any(path.suffix in (".vhd", ".vhdl") for path in spec.sources):
        yield ("static",), "VHDL: yosys reads Verilog", "give Verilog"
    if spec.block_design:
        yield ("static", "block_design"), "a block design needs the vendor's tools", "leave it out"


def _clocks(system: System) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    first = system.domains[0].clock
    used = {region.spec.clock for region in system.regions}
    for region in system.regions:
        clock = region.spec.clock
        if clock != first:
            message = (
                f"{clock} beside {first}, on which the control registers run, is a second clock: the static part of "
                "the open flow has one"
            )
            other = f", or {clock} listed first under clocks" if used == {clock} else ""
            yield ("regions", region.name, "clock"), message, f"clock: {first}{other}"


def _region(region: RegionPlan) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    areas = [rectangle(text) for text in region.spec.pblock]
    if not areas or any(area is None for area in areas):
        yield ("pblock",), "the open flow wants ranges of sites", "such as SLICE_X22Y50:SLICE_X31Y99"
    for bus in region.streams:
        if bus.dma is not None:
            key = ("interfaces", bus.interface.name)
            yield from ((key, message, hint) for message, hint in _stream(bus.dma))
    for interface in region.memory:
        yield ("interfaces", interface.name), "a master to memory needs the vendor's SmartConnect", "connect: none"
    if len(region.clocks) != 1:
        message = f"{len(region.clocks)} clocks at the boundary: {', '.join(region.clocks) or 'none'}"
        yield ("clocks",), message, f"modules whose only clock is that of the region, {region.spec.clock}"
    if any(bus.full for bus in region.registers):
        yield (
            ("interfaces",),
            "an AXI4 slave of bursts: the bridge gives AXI4-Lite",
            "give the module an AXI4-Lite slave",
        )


def _stream(dma: Dma) -> Iterator[tuple[str, str]]:
    if dma.kind is not EngineKind.DMA:
        message = f"engine {dma.engine} is one of {dma.kind.guide}, which is the vendor's IP"
        yield message, "connect: dma, each stream with an engine of its own, or one of either direction"
    elif dma.width > WIDEST:
        yield f"a stream of {dma.width} bits: ports to memory have {WIDEST}", f"at most {WIDEST} bits"


def _module(one: Implementation) -> Iterator[tuple[str, str]]:
    module = one.module
    if module.ip or module.tcl or module.ip_repositories or module.component:
        yield "vendor IP cannot be synthesised by yosys", "give its Verilog"
    if in_libraries(module.libraries) or any(path.suffix.lower() in (".vhd", ".vhdl") for path in module.sources):
        yield "VHDL: yosys reads Verilog", "give Verilog"
