# SPDX-License-Identifier: Apache-2.0
"""What streams share: the switch, the ports of an MCDMA, and interrupt lines if there are more channels than lines.

AXI masters of a region: decoupler between the module and the block design's way to memory.
"""

from __future__ import annotations

from collections.abc import Iterable

from cm.design.generate import axi
from cm.design.generate.static_part.site import Site
from cm.design.generate.verilog_module import Netlist, concat, ones, zeros
from cm.design.hdl.model import Interface, PortDirection
from cm.design.plan.dma_engines import Engine
from cm.design.plan.system import StreamBus, SwitchPlan, System
from cm.schema.model import Direction

IN, OUT = PortDirection.IN, PortDirection.OUT


def add_memory(site: Site, interface: Interface) -> None:
    """The decoupler of an AXI4 or AXI4-Lite master."""
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


TDEST = 4  # bits of an MCDMA's


def add_shared(net: Netlist, system: System) -> None:
    """The switch, joins and splits of all shared engines, and the joined interrupt lines."""
    if system.switch:
        _switch(net, system, system.switch)
    for engine in system.engines:
        for way in engine.directions if engine.channels[0].shared else ():
            _streams(net, engine, way)
    for line in system.crowded:
        names = [net.port(f"irq_{dma.name}", IN) for dma in system.dmas if dma.line == line]
        net.assign(net.port(f"irq_line_{line}", OUT), " | ".join(names))


def _streams(net: Netlist, engine: Engine, way: Direction) -> None:
    """Between the engine's port of one direction and its channels' streams."""
    sends, channels = way is Direction.MM2S, engine.of(way)
    count, size = len(channels), channels[0].width // 8
    outside, inside = ("s", "m") if sends else ("m", "s")
    widths = {"tdata": 8 * size, "tkeep": size}
    connections: dict[str, str | None] = {"clk": f"clk_{engine.clock}", "resetn": f"resetn_{engine.clock}"}
    for signal in ("tvalid", "tready", "tdata", "tkeep", "tlast"):
        forward = (signal != "tready") != sends
        width = widths.get(signal, 1)
        port = net.port(f"{engine.port(way)}_{signal}", OUT if forward else IN, width)
        connections[f"{outside}_{signal}"] = port
        connections[f"{inside}_{signal}"] = _lanes(net, (dma.name for dma in channels), signal, width, sends)
    connections[f"{outside}_tdest"] = net.port(f"{engine.port(way)}_tdest", IN if sends else OUT, TDEST)
    kind = "cm_axis_split" if sends else "cm_axis_join"
    comment = f"{engine.name}: {count} streams on the engine's one"
    net.instance(kind, f"{engine.name}_{way.value}", connections, {"COUNT": count, "BYTES": size}, comment)


def _lanes(net: Netlist, names: Iterable[str], signal: str, width: int, given: bool) -> str:
    """Concatenate the streams' signals, the first one lowest; `given`: they go to the streams, not from them."""
    there = {signal.name for signal in (*net.wires, *net.ports)}
    return concat(reversed([_lane(net, f"axis_{name}_{signal}", width, given, there) for name in names]))


def _lane(net: Netlist, name: str, width: int, given: bool, there: set[str]) -> str:
    if name in there:
        return name
    net.wire(name, width)  # a region without TKEEP
    if given:
        net.unused.append(name)
    else:
        net.assign(name, ones(width))
    return name


def _switch(net: Netlist, system: System, switch: SwitchPlan) -> None:
    """The switch between its streams' ports, or what shares an engine with others, and the regions' decouplers."""
    domain = next(domain for domain in system.domains if domain.clock == switch.clock)
    size = switch.width // 8
    widths = {"tdata": 8 * size, "tkeep": size}
    for bus in switch.streams:
        _own_stream(net, bus, widths)
    connections: dict[str, str | None] = {"clk": f"clk_{switch.clock}", "resetn": f"resetn_{switch.clock}"}
    connections |= axi.slave_pins(domain, "switch")
    for side, ends in (("source", switch.sources), ("sink", switch.sinks)):
        for signal in ("tvalid", "tready", "tdata", "tkeep", "tlast"):
            given = (side == "sink") == (signal != "tready")
            lanes = _lanes(net, (bus.name for bus in ends.values()), signal, widths.get(signal, 1), given)
            connections[f"{side}_{signal}"] = lanes
    parameters = {"SOURCES": len(switch.sources), "SINKS": len(switch.sinks), "BYTES": size}
    listed = [f"sources {', '.join(switch.sources)}", f"sinks {', '.join(switch.sinks)}"]
    net.instance("cm_axis_switch", "stream_switch", connections, parameters, f"Stream switch: {'; '.join(listed)}")


def _own_stream(net: Netlist, bus: StreamBus, widths: dict[str, int]) -> None:
    """Connect a stream between switch and memory; the join or split of a shared engine's port follows behind it."""
    assert bus.dma
    for signal in ("tvalid", "tready", "tdata", "tkeep", "tlast"):
        name, width = f"axis_{bus.name}_{signal}", widths.get(signal, 1)
        if bus.dma.shared:
            net.wire(name, width)
        else:
            net.port(name, IN if (signal != "tready") == bus.dma.sends else OUT, width)
