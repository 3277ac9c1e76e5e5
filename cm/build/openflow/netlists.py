# SPDX-License-Identifier: Apache-2.0
"""The Verilog that only this flow needs: the top, and both sides of a region's anchors.

A harness of flip-flops stands on the other side of the anchors, so that the tools see paths end and begin
there; it is left out of the bitstreams.
"""

from __future__ import annotations

from cm.build.generate.netlist import Netlist
from cm.build.generate.static_part.module import static_part
from cm.build.generate.wrapper import black_box
from cm.build.openflow.layout import BoundaryBit, boundary_bits
from cm.build.plan.system import RegionPlan, System

TOP, MODULE_TOP = "cm_open_top", "cm_open_module"
ANCHOR, HARNESS = "cm_anchor_", "cm_harness_"
_SYSTEM = ("awaddr", "awprot", "awvalid", "awready", "wdata", "wstrb", "wvalid", "wready", "bresp", "bvalid", "bready")
_SYSTEM_READ = ("araddr", "arprot", "arvalid", "arready", "rdata", "rresp", "rvalid", "rready")


def bits_of_region(region: RegionPlan) -> tuple[BoundaryBit, ...]:
    """The wires that cross a region's boundary."""
    return boundary_bits(region, black_box(region).ports)


def open_top(system: System) -> Netlist:
    """``cm_open_top``: the generated static part on a processing system without a block design."""
    static = static_part(system)
    net = Netlist(TOP, f"Top of {system.project.name} for the open flow: processing system and static part.")
    (domain,) = system.domains
    own = {f"clk_{domain.clock}", f"resetn_{domain.clock}", "irq"}
    inner: dict[str, str | None] = {}
    outer: dict[str, str | None] = {"clk": f"clk_{domain.clock}", "resetn": f"resetn_{domain.clock}"}
    prefix = f"s_axi_{domain.clock}_"
    for port in static.ports:
        inner[port.name] = port.name
        if port.name in own or port.name.startswith(prefix):
            net.wire(port.name, port.width)
        else:
            assert port.direction is not None
            net.port(port.name, port.direction, port.width)
    outer |= {f"m_axi_{name}": f"{prefix}{name}" for name in (*_SYSTEM, *_SYSTEM_READ)}
    outer["irq"] = "irq" if "irq" in inner else "1'b0"
    net.instance("cm_open_system", "system", outer)
    net.instance("cm_static", "static_part", inner)
    return net


def static_side(region: RegionPlan) -> Netlist:
    """The region as the static part is placed with it: anchors, and the harness in the modules' place."""
    net = black_box(region)
    net.black_box = False
    net.doc = f"Region {region.name}: anchors of its boundary, and flip-flops in the place of a module."
    bits = bits_of_region(region)
    _harness_clock(net, region)
    for number, clock in enumerate(region.clocks):  # a clock is brought to the region's rows, whatever stands there
        _flip_flop(net, f"{HARNESS}{region.index}_spine{number}", "cm_toggle", None, clock)
    for bit in bits:
        if bit.into:
            _arrives(net, bit, bit.signal)
        else:
            _departs(net, bit, bit.signal)
    return net


def module_side(region: RegionPlan) -> Netlist:
    """``cm_open_module``: a module's wrapper behind the anchors, and the harness in the static part's place."""
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
    """A signal ends here: anchor, a look-up table that keeps tools from packing it, a flip-flop."""
    anchored, hop = net.wire(f"cm_a{bit.label}"), net.wire(f"cm_h{bit.label}")
    _lut(net, f"{ANCHOR}{bit.label}", signal, anchored)
    _lut(net, f"{HARNESS}{bit.label}_lut", anchored, hop)
    _flip_flop(net, f"{HARNESS}{bit.label}_ff", hop, None)


def _departs(net: Netlist, bit: BoundaryBit, signal: str) -> None:
    """A signal begins here: a flip-flop, then the anchor."""
    begun = net.wire(f"cm_b{bit.label}")
    _flip_flop(net, f"{HARNESS}{bit.label}_ff", "cm_toggle", begun)
    _lut(net, f"{ANCHOR}{bit.label}", begun, signal)


def _harness_clock(net: Netlist, region: RegionPlan) -> None:
    """A clock of the harness's own, made of a look-up table: its paths are told apart by it."""
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
