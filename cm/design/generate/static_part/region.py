# SPDX-License-Identifier: Apache-2.0
"""One region of the static part: black box, reset, decouplers, what its ports are connected to."""

from __future__ import annotations

from cm.design.boundary.model import Role
from cm.design.boundary.scalar_signals import reset_of
from cm.design.generate.static_part.registers import add_registers
from cm.design.generate.static_part.shared import add_memory
from cm.design.generate.static_part.site import Site
from cm.design.generate.static_part.streams import add_stream
from cm.design.generate.verilog_module import Netlist, ones, zeros
from cm.design.hdl.model import PortDirection
from cm.design.plan.system import RegionPlan, System

IN, OUT, INOUT = PortDirection.IN, PortDirection.OUT, PortDirection.INOUT


def add_region(net: Netlist, system: System, region: RegionPlan) -> None:
    """Add a region to the static part, in an order in which the file reads well."""
    site = Site(net, system, region)
    _declare(site)
    _control(site)
    for registers in site.region.registers:
        add_registers(site.at(registers.interface), registers)
    for stream in site.region.streams:
        add_stream(site.at(stream.interface), stream)
    for interface in site.region.memory:
        add_memory(site.at(interface), interface)
    site.join()
    _interrupts(site)
    _external(site)
    _rest(site)
    index = site.region.index
    site.to_control("decoupled", " && ".join([site.cut, *site.drained]), index)
    site.to_control("stuck", " || ".join(site.stuck) or "1'b0", index)


def _declare(site: Site) -> None:
    net, region = site.net, site.region
    connections: dict[str, str | None] = {}
    for port in region.boundary.ports:
        width = port.width
        if port.direction is INOUT:
            connections[port.name] = net.port(f"ext_{site.wire(port.name)}", INOUT, width)
        else:
            connections[port.name] = net.wire(site.wire(port.name), width)
    connections["cm_identity"] = net.wire(site.wire("cm_identity"), 32)
    net.instance(region.module, site.name, connections, comment=f"Region {site.name}")


def _control(site: Site) -> None:
    """Synchronise decoupling and reset to the region's clock, and the identity back."""
    net, index = site.net, site.region.index
    request, hold = net.wire(f"{site.name}_request", 2), net.wire(f"{site.name}_hold")
    reset, busy = net.wire(f"{site.name}_resetn_out"), net.wire(f"{site.name}_busy")
    net.wire(site.cut)
    site.cm_sync(f"{site.name}_request", site.clock, f"{{region_reset[{index}], decouple[{index}]}}", request, 2)
    net.assign(hold, f"|{request}")
    connections: dict[str, str | None] = {"clk": site.clock, "resetn": site.reset, "hold": hold}
    connections |= {"region_resetn": reset, "busy": busy}
    net.instance("cm_region_reset", f"{site.name}_reset", connections)
    net.assign(site.cut, busy if site.region.spec.decoupling else "1'b0")
    if not site.region.spec.decoupling:
        net.unused.append(busy)
    _clocks(site, reset)
    known = net.wire(f"{site.name}_known", 32)
    net.assign(known, f"{site.wire('cm_identity')} & {{32{{!{site.cut}}}}}")
    site.cm_sync(f"{site.name}_identity", site.main, known, f"identity[{32 * index}+:32]", 32)


def _clocks(site: Site, reset: str) -> None:
    """Connect each clock of the modules, with the reset synchronised to it."""
    for port in site.region.boundary.ports:
        if port.role is Role.CLOCK and port.direction is IN:
            clock = site.region.clocks.get(port.name)
            if clock != "external":
                site.net.assign(site.wire(port.name), f"clk_{clock or site.region.spec.clock}")
                site.done.add(port.name)
        elif port.role is Role.RESET and port.direction is IN:
            owner = next((name for name in site.region.clocks if reset_of(name) == port.name), None)
            if owner is None or site.region.clocks[owner] in (site.region.spec.clock, None):
                site.net.assign(site.wire(port.name), reset)
            else:
                site.cm_sync(site.wire(port.name), site.wire(owner), reset, site.wire(port.name))
            site.done.add(port.name)


def _interrupts(site: Site) -> None:
    """Pass on interrupts: masked while the region is cut off, and long enough for the control registers' clock."""
    cycles = _stretch(site)
    for port in dict.fromkeys(line.port for line in site.region.lines):
        width = next(p.width for p in site.region.boundary.ports if p.name == port)
        gated = site.net.wire(f"{site.name}_{port}_gated", width)
        site.net.assign(gated, f"{site.wire(port)} & {{{width}{{!{site.cut}}}}}")
        site.done.add(port)
        source = gated
        if cycles:
            source = site.net.wire(f"{site.name}_{port}_long", width)
            connections: dict[str, str | None] = {"clk": site.clock, "resetn": site.reset, "d": gated, "q": source}
            parameters = {"WIDTH": width, "CYCLES": cycles}
            site.net.instance("cm_stretch", f"{site.name}_{port}_stretch", connections, parameters)
        for line in site.region.lines:
            if line.port == port:
                site.net.assign(f"irq_lines[{line.bit}]", source if width == 1 else f"{source}[{line.index}]")


def _stretch(site: Site) -> int:
    """Pulse length, in clocks of the region, that the control registers' clock cannot miss; 0 on the same clock."""
    own, main = site.system.project.clocks[site.region.spec.clock], site.system.domains[0]
    return 0 if own.name == main.clock else min(255, 2 * -(-own.rate // main.rate) + 2)


def _external(site: Site) -> None:
    """Connect ports of the top; outputs read as idle while the region is cut off."""
    for port in site.region.external:
        site.done.add(port.name)
        if port.direction is INOUT:
            continue
        name = site.net.port(f"ext_{site.wire(port.name)}", port.direction, port.width)
        if port.direction is IN:
            site.net.assign(site.wire(port.name), name)
        elif port.idle:
            site.net.assign(name, f"{site.wire(port.name)} | {{{port.width}{{{site.cut}}}}}")
        else:
            site.net.assign(name, f"{site.wire(port.name)} & {{{port.width}{{!{site.cut}}}}}")


def _rest(site: Site) -> None:
    """Tie undriven inputs to 0 (TSTRB: 1), and mark outputs that nothing reads."""
    for port in site.region.boundary.ports:
        if port.name in site.done or port.direction is INOUT:
            continue
        if port.direction is IN:
            fill = ones if port.logical == "TSTRB" else zeros
            site.net.assign(site.wire(port.name), fill(port.width))
        else:
            site.net.unused.append(site.wire(port.name))
