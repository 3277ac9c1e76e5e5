# SPDX-License-Identifier: Apache-2.0
"""MCDMA engines in the simulated static part: what connects their channels to the streams that they share.

The engine itself is not simulated. Its channels are ports, ``dma_<channel>_…``, behind the library's own join and
split, with their roles exchanged: they do to streams what the engine does, packets of several channels one after the
other, with TDEST.
"""

from __future__ import annotations

from cm.design.generate.netlist import Netlist, Signal, concat
from cm.design.hdl.model import PortDirection
from cm.design.plan.engines import Dma, Engine
from cm.design.plan.system import System
from cm.schema.model import Direction

IN, OUT = PortDirection.IN, PortDirection.OUT


def prefix_of(dma: Dma) -> str:
    """How the names of a channel's ports begin."""
    return f"dma_{dma.name}" if dma.shared else f"axis_{dma.name}"


def add_engines(net: Netlist, system: System) -> None:
    """Put the channels of each shared engine in front of its ports."""
    for engine in system.engines:
        for way in engine.directions if engine.channels[0].shared else ():
            _channels(net, engine, way)


def _channels(net: Netlist, engine: Engine, way: Direction) -> None:
    sends, channels = way is Direction.MM2S, engine.of(way)
    size = channels[0].width // 8
    widths = {"tdata": 8 * size, "tkeep": size, "tdest": 4}
    inside, outside = ("m", "s") if sends else ("s", "m")
    connections: dict[str, str | None] = {"clk": f"clk_{engine.clock}", "resetn": f"resetn_{engine.clock}"}
    for signal in ("tvalid", "tready", "tdata", "tkeep", "tlast", "tdest"):
        name, width = f"{engine.port(way)}_{signal}", widths.get(signal, 1)
        net.ports[:] = [port for port in net.ports if port.name != name]
        net.wires.append(Signal(name, width))
        connections[f"{inside}_{signal}"] = name
        if signal != "tdest":
            direction = IN if (signal != "tready") == sends else OUT
            lanes = [net.port(f"{prefix_of(dma)}_{signal}", direction, width) for dma in channels]
            connections[f"{outside}_{signal}"] = concat(reversed(lanes))
    kind = "cm_axis_join" if sends else "cm_axis_split"
    parameters = {"COUNT": len(channels), "BYTES": size}
    net.instance(kind, f"engine_{engine.name}_{way.value}", connections, parameters, f"MCDMA {engine.name}")
