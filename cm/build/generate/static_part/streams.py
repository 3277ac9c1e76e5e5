# SPDX-License-Identifier: Apache-2.0
"""AXI4-Streams of a region: decoupler between a DMA engine, or ports of the top, and the module."""

from __future__ import annotations

from cm.build.generate import axi
from cm.build.generate.netlist import concat, low_bits, ones, zeros
from cm.build.generate.static_part.site import Site
from cm.build.hdl.model import PortDirection
from cm.build.plan.system import StreamBus

IN, OUT = PortDirection.IN, PortDirection.OUT


def add_stream(site: Site, bus: StreamBus) -> None:
    """The decoupler of a stream in either direction."""
    interface = bus.interface
    sends = interface.mode.value == "master"
    kept = ("TDATA", "TKEEP") if bus.dma else axi.STREAM
    packed = axi.fields(interface, kept)
    inside = concat(site.take(field) for field in packed)
    outside = concat(_stream_port(site, bus, field, sends) for field in packed)
    last = "TLAST" in interface.ports
    region, static = ("s", "m") if sends else ("m", "s")
    connections: dict[str, str | None] = {
        f"{region}_tvalid": site.pin(interface, "TVALID", "1'b1"),
        f"{region}_tready": site.pin(interface, "TREADY", None if sends else "1'b1"),
        f"{region}_tlast": site.pin(interface, "TLAST", "1'b0" if sends else None),
        f"{region}_tpayload": inside,
        f"{static}_tpayload": outside,
    }
    direction, back = (OUT, IN) if sends else (IN, OUT)
    connections[f"{static}_tvalid"] = site.net.port(f"axis_{bus.name}_tvalid", direction)
    connections[f"{static}_tready"] = site.net.port(f"axis_{bus.name}_tready", back)
    connections[f"{static}_tlast"] = site.net.port(f"axis_{bus.name}_tlast", direction)
    parameters: dict[str, object] = {"PAYLOAD_WIDTH": sum(field.width for field in packed), "HAS_LAST": int(last)}
    if sends:
        closing = concat(ones(f.width) if f.logical in ("TKEEP", "TSTRB") else zeros(f.width) for f in packed)
        parameters["CLOSING"] = closing
    kind = "cm_axis_master_decoupler" if sends else "cm_axis_slave_decoupler"
    site.decoupler(kind, interface, connections, **parameters)


def _stream_port(site: Site, bus: StreamBus, field: axi.Field, sends: bool) -> str:
    """The static part's port of a signal; a DMA's is as wide as its data, the bits above are zero."""
    width = field.width
    if bus.dma:
        width = bus.dma.width if field.logical == "TDATA" else bus.dma.width // 8
    name = site.net.port(f"axis_{bus.name}_{field.logical.lower()}", OUT if sends else IN, width)
    used = low_bits(name, width, field.width)
    if width > field.width:
        rest = f"{name}[{width - 1}:{field.width}]"
        if sends:
            fill = ones if field.logical == "TKEEP" else zeros
            site.net.assign(rest, fill(width - field.width))
        else:
            site.net.unused.append(rest)
    return used
