# SPDX-License-Identifier: Apache-2.0
"""AXI masters of a region: decoupler between the module and the block design's way to memory."""

from __future__ import annotations

from cm.design.generate import axi
from cm.design.generate.netlist import concat, ones, zeros
from cm.design.generate.static_part.site import Site
from cm.design.hdl.model import Interface, PortDirection
from cm.design.plan.system import MemoryBus

IN, OUT = PortDirection.IN, PortDirection.OUT


def add_memory(site: Site, bus: MemoryBus) -> None:
    """The decoupler of an AXI4 or AXI4-Lite master."""
    interface = bus.interface
    data = axi.width_of(interface, "WDATA" if interface.writes else "RDATA")
    connections: dict[str, str | None] = {}
    parameters: dict[str, object] = {"DATA_WIDTH": data}
    groups = {
        "AW": axi.fields(interface, (*axi.ADDRESS, "ID"), "AW"),
        "AR": axi.fields(interface, (*axi.ADDRESS, "LEN", "ID"), "AR"),
        "B": axi.fields(interface, ("RESP", "ID"), "B"),
        "R": axi.fields(interface, ("DATA", "RESP", "ID"), "R"),
    }
    for channel, packed in groups.items():
        lane = f"{channel.lower()}payload"
        parameters[f"{channel}_WIDTH"] = sum(field.width for field in packed) or 1
        into = channel in ("AW", "AR")
        inside = concat(site.take(field) for field in packed) if packed else ("1'b0" if into else None)
        outside = concat(_memory_port(site, interface, field) for field in packed) if packed else None
        connections[f"s_{lane}"] = inside
        connections[f"m_{lane}"] = outside if outside or into else "1'b0"
    connections |= _memory_handshakes(site, interface, data)
    site.decoupler("cm_axi_master_decoupler", interface, connections, **parameters)


def _memory_port(site: Site, interface: Interface, field: axi.Field) -> str:
    name = f"m_axi_{site.name}_{interface.name}_{field.logical.lower()}"
    direction = IN if field.logical in axi.FROM_SLAVE else OUT
    return site.net.port(name, direction, field.width)


def _memory_handshakes(site: Site, interface: Interface, data: int) -> dict[str, str | None]:
    pins: dict[str, str | None] = {}
    widths = {"AWLEN": 8, "WDATA": data, "WSTRB": data // 8}
    tied = {"AWLEN": zeros(8), "WDATA": zeros(data), "WSTRB": ones(data // 8), "RLAST": "1'b1"}
    from_region = ("AWVALID", "AWLEN", "WVALID", "WDATA", "WSTRB", "BREADY", "ARVALID", "RREADY")
    to_region = ("AWREADY", "WREADY", "BVALID", "ARREADY", "RVALID", "RLAST")
    for name in (*from_region, *to_region):
        missing = tied.get(name, "1'b0") if name in from_region else None
        pins[f"s_{name.lower()}"] = site.pin(interface, name, missing)
    for name in (*from_region, "WLAST", *to_region):
        present = name in interface.ports
        field = axi.Field(name, "", widths.get(name, 1))
        missing = tied.get(name, "1'b0") if name in to_region else None
        pins[f"m_{name.lower()}"] = _memory_port(site, interface, field) if present else missing
    if "WLAST" in interface.ports:
        site.done.add(interface.ports["WLAST"])  # the decoupler counts the beats itself
        site.net.unused.append(site.wire(interface.ports["WLAST"]))
    return pins
