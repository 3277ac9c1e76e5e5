# SPDX-License-Identifier: Apache-2.0
"""AXI4-Streams of a region: decoupler between a DMA engine, or ports of the top, and the module.

A DMA engine is 8, 16, 32 … bits wide. A stream of another width gets a converter (``cm_axis_width.v``) on the static
side of its decoupler, so that memory holds exactly the bytes of the stream.
"""

from __future__ import annotations

from cm.design.generate import axi
from cm.design.generate.static_part.site import Site
from cm.design.generate.verilog_module import Netlist, concat, low_bits, ones, zeros
from cm.design.hdl.model import PortDirection
from cm.design.plan.dma_engines import EngineKind
from cm.design.plan.system import StreamBus

IN, OUT = PortDirection.IN, PortDirection.OUT


def add_stream(site: Site, bus: StreamBus) -> None:
    """Add the decoupler of a stream in either direction, with a converter if the DMA's width differs."""
    interface = bus.interface
    sends = interface.mode.value == "master"
    packed = axi.fields(interface, _kept(bus))
    static = _Converted(site, bus, sends) if bus.converted else _Ports(site, bus, sends)
    region, other = ("s", "m") if sends else ("m", "s")
    connections: dict[str, str | None] = {
        f"{region}_tvalid": site.pin(interface, "TVALID", "1'b1"),
        f"{region}_tready": site.pin(interface, "TREADY", None if sends else "1'b1"),
        f"{region}_tlast": site.pin(interface, "TLAST", "1'b0" if sends else None),
        f"{region}_tpayload": concat(site.take(field) for field in packed),
        f"{other}_tpayload": concat(static.payload(field) for field in packed),
    }
    for name in ("tvalid", "tready", "tlast"):
        connections[f"{other}_{name}"] = static.handshake(name)
    last = "TLAST" in interface.ports
    parameters: dict[str, object] = {"PAYLOAD_WIDTH": sum(field.width for field in packed), "HAS_LAST": int(last)}
    if sends:
        closing = concat(ones(f.width) if f.logical in ("TKEEP", "TSTRB") else zeros(f.width) for f in packed)
        parameters["CLOSING"] = closing
    kind = "cm_axis_master_decoupler" if sends else "cm_axis_slave_decoupler"
    site.decoupler(kind, interface, connections, **parameters)
    static.finish()


def _kept(bus: StreamBus) -> tuple[str, ...]:
    """The signals that pass: a DMA engine knows TDATA and TKEEP, a VDMA the first pixel by TUSER too."""
    if bus.external:
        return axi.STREAM
    video = bus.dma is not None and bus.dma.kind is EngineKind.VDMA
    return ("TDATA", "TKEEP", "TUSER") if video else ("TDATA", "TKEEP")


def _end(site: Site, bus: StreamBus, signal: str, direction: PortDirection, width: int) -> str:
    """A signal of the static side: a port of the static part, or a wire to the switch or the join of an engine."""
    name = f"axis_{bus.name}_{signal}"
    if bus.inner:
        return site.net.wire(name, width)
    return site.net.port(name, direction, width)


def _low_bits(net: Netlist, name: str, width: int, field: axi.Field, sends: bool) -> str:
    """The bits of a signal of the static side that the region has; those above are zero (of TKEEP one)."""
    if width > field.width:
        rest = f"{name}[{width - 1}:{field.width}]"
        if sends:
            net.assign(rest, (ones if field.logical == "TKEEP" else zeros)(width - field.width))
        else:
            net.unused.append(rest)
    return low_bits(name, width, field.width)


class _Ports:
    """The static part's ports of a stream; a DMA's are as wide as its data, the bits above are zero."""

    def __init__(self, site: Site, bus: StreamBus, sends: bool) -> None:
        self._site, self._bus, self._sends = site, bus, sends

    def handshake(self, name: str) -> str:
        """The port of TVALID, TREADY or TLAST."""
        forward = OUT if self._sends else IN
        back = IN if self._sends else OUT
        return _end(self._site, self._bus, name, back if name == "tready" else forward, 1)

    def payload(self, field: axi.Field) -> str:
        """The port of a signal, or its bits that the region has."""
        width, outside = field.width, self._bus.width
        if outside:
            width = {"TDATA": outside, "TKEEP": outside // 8}.get(field.logical, 1)
        name = _end(self._site, self._bus, field.logical.lower(), OUT if self._sends else IN, width)
        if width < field.width and self._sends:  # a VDMA's TUSER is one bit
            wide = self._site.net.wire(f"{name}_of_region", field.width)
            self._site.net.assign(name, low_bits(wide, field.width, width))
            self._site.net.unused.append(f"{wide}[{field.width - 1}:{width}]")
            return wide
        return _low_bits(self._site.net, name, width, field, self._sends)

    def finish(self) -> None:
        """Do nothing: there is no converter to add."""


class _Converted:
    """Wires between decoupler and converter, and the DMA's ports behind it."""

    def __init__(self, site: Site, bus: StreamBus, sends: bool) -> None:
        self._site, self._bus, self._sends = site, bus, sends
        self._name = f"{site.name}_{bus.interface.name}_bytes"
        self._keep = "TKEEP" in bus.interface.ports
        net = site.net
        for signal in ("tvalid", "tready", "tlast"):
            net.wire(f"{self._name}_{signal}")
        net.wire(f"{self._name}_tdata", 8 * bus.bytes)
        if self._keep or not sends:
            net.wire(f"{self._name}_tkeep", bus.bytes)

    def handshake(self, name: str) -> str:
        """The wire of TVALID, TREADY or TLAST."""
        return f"{self._name}_{name}"

    def payload(self, field: axi.Field) -> str:
        """The wire of TDATA or TKEEP; the last byte of TDATA may have fewer than eight bits."""
        name, net = f"{self._name}_{field.logical.lower()}", self._site.net
        width = 8 * self._bus.bytes if field.logical == "TDATA" else self._bus.bytes
        return _low_bits(net, name, width, field, self._sends)

    def finish(self) -> None:
        """Add the converter."""
        net, bus = self._site.net, self._bus
        dma_bytes, inside, outside = bus.width // 8, "s" if self._sends else "m", "m" if self._sends else "s"
        pins: dict[str, str | None] = {"clk": self._site.clock, "resetn": self._site.reset}
        for signal in ("tvalid", "tready", "tdata", "tkeep", "tlast"):
            pins[f"{inside}_{signal}"] = f"{self._name}_{signal}"
            forward = (signal != "tready") == self._sends
            width = {"tdata": bus.width, "tkeep": dma_bytes}.get(signal, 1)
            pins[f"{outside}_{signal}"] = _end(self._site, bus, signal, OUT if forward else IN, width)
        if not self._keep and self._sends:
            pins["s_tkeep"] = ones(bus.bytes)
        elif not self._keep:
            net.unused.append(f"{self._name}_tkeep")
        sizes = (bus.bytes, dma_bytes) if self._sends else (dma_bytes, bus.bytes)
        parameters = {"IN_BYTES": sizes[0], "OUT_BYTES": sizes[1]}
        other = "switch" if bus.switched else "DMA"
        comment = f"{self._site.name}.{bus.interface.name}: {bus.bytes} bytes a beat, {dma_bytes} of the {other}"
        net.instance("cm_axis_width", f"{self._name}_width", pins, parameters, comment)
