# SPDX-License-Identifier: Apache-2.0
"""Register interfaces of a region: decoupler between the interconnect, or the block design, and the module."""

from __future__ import annotations

from cm.design.generate import axi
from cm.design.generate.axi import LITE, slave_port
from cm.design.generate.static_part.site import Site
from cm.design.generate.verilog_module import Netlist, concat, low_bits, zeros
from cm.design.hdl.model import Interface, PortDirection
from cm.design.plan.system import RegionPlan, RegisterBus, System

IN, OUT = PortDirection.IN, PortDirection.OUT


def add_registers(site: Site, bus: RegisterBus) -> None:
    """The decoupler of an AXI4-Lite or AXI4 slave."""
    interface = bus.interface
    stuck = site.net.wire(f"{site.name}_{interface.name}_stuck")
    site.stuck.append(stuck)
    connections: dict[str, str | None] = {"clear": f"!{site.region_reset}", "stuck": stuck}
    parameters: dict[str, object] = {"ID_WIDTH": axi.id_width(interface)}
    outside = _Outside(site.net, site.system, site.region, bus)
    for channel, kinds in (("AW", axi.ADDRESS), ("W", ("DATA", "STRB")), ("AR", axi.ADDRESS)):
        packed = axi.fields(interface, kinds, channel)
        lane = channel.lower()
        inside = concat(site.take(field) for field in packed) if packed else None
        parameters[f"{channel}_WIDTH"] = sum(field.width for field in packed) or 1
        connections[f"s_{lane}payload"] = (
            concat(outside.signal(f.logical, f.width) for f in packed) if packed else "1'b0"
        )
        connections[f"m_{lane}payload"] = inside
    width = axi.width_of(interface, "RDATA") if interface.reads else 1
    parameters["R_WIDTH"] = width
    connections["m_rpayload"] = site.pin(interface, "RDATA", zeros(width))
    connections["s_rpayload"] = outside.signal("RDATA", width)
    connections |= _handshakes(site, interface) | outside.handshakes(parameters["ID_WIDTH"])
    site.decoupler("cm_axi_slave_decoupler", interface, connections, **parameters)


def _handshakes(site: Site, interface: Interface) -> dict[str, str | None]:
    """Region side of a slave; a missing channel answers at once with SLVERR."""
    pins: dict[str, str | None] = {}
    for name in ("AWVALID", "AWLEN", "AWID", "WVALID", "WLAST", "BREADY", "ARVALID", "ARLEN", "ARID", "RREADY"):
        pins[f"m_{name.lower()}"] = site.pin(interface, name, None)
    for name in ("AWREADY", "WREADY", "BVALID", "ARREADY", "RVALID"):
        pins[f"m_{name.lower()}"] = site.pin(interface, name, "1'b1")
    pins["m_bresp"] = site.pin(interface, "BRESP", "2'b00" if interface.writes else "2'b10")
    pins["m_rresp"] = site.pin(interface, "RRESP", "2'b00" if interface.reads else "2'b10")
    return pins


class _Outside:
    """Where a register bus meets the static part: the interconnect, or ports to the block design."""

    def __init__(self, net: Netlist, system: System, region: RegionPlan, bus: RegisterBus) -> None:
        self._net, self._system, self._region, self._bus = net, system, region, bus

    def signal(self, logical: str, width: int) -> str:
        """The static side's signal, `width` bits of it."""
        signal = logical.lower()
        if self._bus.full:
            name = f"s_axi_{self._region.name}_{self._bus.interface.name}_{signal}"
            return self._net.port(name, OUT if logical in axi.FROM_SLAVE else IN, width)
        domain = next(d for d in self._system.domains if d.clock == self._region.clock_of(self._bus.interface))
        have = next((bits for known, _, bits in LITE if known == signal), None)
        if have is None:  # AWCACHE and the like, which some AXI4-Lite slaves have against the specification
            return zeros(width)
        return low_bits(slave_port(domain, self._bus.window.name, signal), have, width)

    def handshakes(self, id_width: object) -> dict[str, str | None]:
        """Static side of the handshakes."""
        assert isinstance(id_width, int)
        pins: dict[str, str | None] = {}
        for name in ("AWVALID", "AWREADY", "WVALID", "WREADY", "BVALID", "BREADY"):
            pins[f"s_{name.lower()}"] = self.signal(name, 1)
        for name in ("ARVALID", "ARREADY", "RVALID", "RREADY"):
            pins[f"s_{name.lower()}"] = self.signal(name, 1)
        pins["s_bresp"], pins["s_rresp"] = self.signal("BRESP", 2), self.signal("RRESP", 2)
        full = self._bus.full and self._bus.interface.protocol != "axi4lite"
        pins["s_awlen"] = self.signal("AWLEN", 8) if full else zeros(8)
        pins["s_arlen"] = self.signal("ARLEN", 8) if full else zeros(8)
        pins["s_wlast"] = self.signal("WLAST", 1) if full else "1'b1"
        pins["s_rlast"] = self.signal("RLAST", 1) if full else None
        for name in ("awid", "arid"):
            pins[f"s_{name}"] = self.signal(name.upper(), id_width) if full else zeros(id_width)
        for name in ("bid", "rid"):
            pins[f"s_{name}"] = self.signal(name.upper(), id_width) if full else None
        return pins
