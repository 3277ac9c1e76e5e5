# SPDX-License-Identifier: Apache-2.0
"""Verilog that only this flow needs: the top, and both sides of a region's anchors.

Each side is placed with a harness of flip-flops behind the anchors, so that timing paths begin and end there;
the harness is left out of the bitstreams.
"""

from __future__ import annotations

from cm.design.generate.axi import LITE
from cm.design.generate.netlist import Netlist, zeros
from cm.design.generate.static_part.module import static_part
from cm.design.generate.wrapper import black_box
from cm.design.openflow.engines import STREAM, add_engines, halves
from cm.design.openflow.layout import BoundaryBit, boundary_bits
from cm.design.openflow.processor import INTERRUPTS, READ, WRITE, memory_pin, processing_system
from cm.design.plan.system import RegionPlan, System
from cm.schema.model import Direction

TOP, MODULE_TOP = "cm_open_top", "cm_open_module"
ANCHOR, HARNESS = "cm_anchor_", "cm_harness_"


def bits_of_region(region: RegionPlan) -> tuple[BoundaryBit, ...]:
    """The wires that cross a region's boundary."""
    return boundary_bits(region, black_box(region).ports)


def open_top(system: System) -> Netlist:
    """``cm_open_top``: the generated static part and its DMA engines on a processing system without a block design."""
    static = static_part(system)
    net = Netlist(TOP, f"Top of {system.project.name} for the open flow: processing system and static part.")
    (domain,) = system.domains
    inner: dict[str, str | None] = {}
    outer: dict[str, str | None] = {"clk": f"clk_{domain.clock}", "resetn": f"resetn_{domain.clock}"}
    prefix = f"s_axi_{domain.clock}_"
    within = {f"clk_{domain.clock}", f"resetn_{domain.clock}", "irq"}
    within |= {f"axis_{dma.name}_{signal}" for dma in system.dmas for signal in STREAM}
    for port in static.ports:
        inner[port.name] = port.name
        if port.name in within or port.name.startswith(prefix):
            net.wire(port.name, port.width)
        else:
            assert port.direction is not None
            net.port(port.name, port.direction, port.width)
    channels = halves(system)
    if system.engines:
        add_engines(net, system, {port.name: port.width for port in static.ports})
        outer |= {f"m_axi_{name}": f"ps_{name}" for name, _, _ in LITE} | {"irq": "irq_lines"}
    else:
        outer |= {f"m_axi_{name}": f"{prefix}{name}" for name, _, _ in LITE}
        outer["irq"] = f"{{{zeros(INTERRUPTS - 1)}, irq}}"
    for way, half in ((Direction.MM2S, READ), (Direction.S2MM, WRITE)):
        for number in range(len(channels[way])):
            outer |= {memory_pin(number, name): memory_pin(number, name) for name, _ in (*half.asks, *half.answers)}
    net.instance("cm_open_system", "system", outer)
    net.instance("cm_static", "static_part", inner)
    return net


def open_system(system: System) -> Netlist:
    """``cm_open_system``: the processing system with the ports to memory that the design's streams need."""
    channels = halves(system)
    return processing_system(len(channels[Direction.MM2S]), len(channels[Direction.S2MM]))


def static_side(region: RegionPlan) -> Netlist:
    """The region as it is placed with the static part: anchors, and the harness in place of the modules."""
    net = black_box(region)
    net.black_box = False
    net.doc = f"Region {region.name}: anchors of its boundary, and flip-flops in the place of a module."
    bits = bits_of_region(region)
    _harness_clock(net, region)
    for number, clock in enumerate(region.clocks):  # so that it reaches the region's rows, whatever is placed there
        _flip_flop(net, f"{HARNESS}{region.index}_spine{number}", "cm_toggle", None, clock)
    for bit in bits:
        if bit.into:
            _arrives(net, bit, bit.signal)
        else:
            _departs(net, bit, bit.signal)
    return net


def module_side(region: RegionPlan) -> Netlist:
    """``cm_open_module``: a module's wrapper behind the anchors, and the harness in place of the static part."""
    net = Netlist(MODULE_TOP, f"A module of region {region.name} behind the anchors of its boundary.")
    bits = bits_of_region(region)
    pins: dict[str, str | None] = dict.fromkeys(region.clocks, "cm_clock")
    net.wire("cm_clock")
    for port in black_box(region).ports:
        if port.name not in pins:
            pins[port.name] = net.wire(port.name, port.width)
    _harness_clock(net, region)
    net.instance("BUFG", "cm_clock_buffer", {"I": "1'b0", "O": "cm_clock"})
    for bit in bits:
        if bit.into:
            _departs(net, bit, bit.signal)
        else:
            _arrives(net, bit, bit.signal)
    net.instance(region.module, "region", pins)
    return net


def _arrives(net: Netlist, bit: BoundaryBit, signal: str) -> None:
    """End a signal: an anchor, a look-up table that keeps the tools from packing it, and a flip-flop."""
    anchored, hop = net.wire(f"cm_a{bit.label}"), net.wire(f"cm_h{bit.label}")
    _lut(net, f"{ANCHOR}{bit.label}", signal, anchored)
    _lut(net, f"{HARNESS}{bit.label}_lut", anchored, hop)
    _flip_flop(net, f"{HARNESS}{bit.label}_ff", hop, None)


def _departs(net: Netlist, bit: BoundaryBit, signal: str) -> None:
    """Begin a signal: a flip-flop, then the anchor."""
    begun = net.wire(f"cm_b{bit.label}")
    _flip_flop(net, f"{HARNESS}{bit.label}_ff", "cm_toggle", begun)
    _lut(net, f"{ANCHOR}{bit.label}", begun, signal)


def _harness_clock(net: Netlist, region: RegionPlan) -> None:
    """Give the harness its own clock, made by a look-up table, so that its paths can be told apart in reports."""
    net.wire("cm_toggle_clock")
    net.wire("cm_toggle")
    net.wire("cm_toggle_next")
    _lut(net, f"{HARNESS}{region.index}_clock", "cm_toggle", "cm_toggle_clock")
    net.instance(
        "LUT1", f"{HARNESS}{region.index}_invert", {"I0": "cm_toggle", "O": "cm_toggle_next"}, {"INIT": "2'b01"}
    )
    _flip_flop(net, f"{HARNESS}{region.index}_toggle", "cm_toggle_next", "cm_toggle")


def _lut(net: Netlist, name: str, source: str, target: str) -> None:
    net.instance("LUT1", name, {"I0": source, "O": target}, {"INIT": "2'b10"})


def _flip_flop(net: Netlist, name: str, source: str, target: str | None, clock: str = "cm_toggle_clock") -> None:
    pins = {"C": clock, "CE": "1'b1", "R": "1'b0", "D": source, "Q": target}
    net.instance("FDRE", name, pins, {"INIT": "1'b0"})
