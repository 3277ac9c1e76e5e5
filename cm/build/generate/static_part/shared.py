# SPDX-License-Identifier: Apache-2.0
"""What several streams share: the ports of an MCDMA, and interrupt lines where channels are more than lines."""

from __future__ import annotations

from cm.build.generate.netlist import Netlist, concat, ones
from cm.build.hdl.model import PortDirection
from cm.build.plan.engines import Dma, Engine
from cm.build.plan.system import System
from cm.schema.model import Direction

IN, OUT = PortDirection.IN, PortDirection.OUT
TDEST = 4  # bits of an MCDMA's


def add_shared(net: Netlist, system: System) -> None:
    """Joins and splits of all shared engines, and the joined interrupt lines."""
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
        connections[f"{inside}_{signal}"] = _lanes(net, engine, way, signal, width)
    connections[f"{outside}_tdest"] = net.port(f"{engine.port(way)}_tdest", IN if sends else OUT, TDEST)
    kind = "cm_axis_split" if sends else "cm_axis_join"
    comment = f"{engine.name}: {count} streams on the engine's one"
    net.instance(kind, f"{engine.name}_{way.value}", connections, {"COUNT": count, "BYTES": size}, comment)


def _lanes(net: Netlist, engine: Engine, way: Direction, signal: str, width: int) -> str:
    """The streams' wires side by side, the first lowest; wires between where a stream lacks the signal."""
    there = {wire.name for wire in net.wires}
    parts = [_lane(net, dma, signal, width, there) for dma in engine.of(way)]
    return concat(reversed(parts))


def _lane(net: Netlist, dma: Dma, signal: str, width: int, there: set[str]) -> str:
    name = f"axis_{dma.name}_{signal}"
    if name in there:
        return name
    net.wire(name, width)  # a region without TKEEP
    if dma.sends:
        net.unused.append(name)
    else:
        net.assign(name, ones(width))
    return name
