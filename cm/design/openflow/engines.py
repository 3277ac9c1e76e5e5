# SPDX-License-Identifier: Apache-2.0
"""The static part's DMA engines in the open flow: ``cm_axi_dma.v``, between the processing system and the streams.

Each stream from memory has the read half of a memory port to itself, and each stream to memory the write half of one:
no arbitration is needed, and there are four of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cm.design.generate.axi import LITE, PER_SLAVE, SHARED
from cm.design.generate.netlist import Netlist, concat, ones
from cm.design.openflow.processor import INTERRUPTS, READ, WORD, WRITE, memory_pin
from cm.design.plan.addresses import Window
from cm.design.plan.engines import Dma, Engine
from cm.design.plan.system import Domain, StreamBus, System
from cm.schema.model import Direction

WIDEST = 8 * WORD  # bits of a stream
STREAM = ("tdata", "tkeep", "tlast", "tvalid", "tready")


def halves(system: System) -> Mapping[Direction, tuple[Dma, ...]]:
    """The channels of each direction, in the order of their memory ports."""
    return {way: tuple(dma for dma in system.dmas if dma.direction is way) for way in Direction}


def add_engines(net: Netlist, system: System, ports: Mapping[str, int]) -> None:
    """Add interconnect, engines and interrupt lines to the top; `ports` are those of the static part, with widths.

    Wires ``ps_…`` belong to the register port of the processing system; wires to the memory ports of
    ``cm_open_system`` have the names of those ports.
    """
    (domain,) = system.domains
    prefix = f"s_axi_{domain.clock}_"
    _registers(net, domain, prefix, system.engines)
    for number, engine in enumerate(system.engines):
        _engine(net, system, engine, number + 1, ports)
    lines = {dma.line: f"irq_{dma.name}" for dma in system.dmas}
    lines[0] = "irq"
    net.assign(net.wire("irq_lines", INTERRUPTS), concat(lines.get(n, "1'b0") for n in reversed(range(INTERRUPTS))))


def _registers(net: Netlist, domain: Domain, prefix: str, engines: tuple[Engine, ...]) -> None:
    """Connect the windows of the static part and of the engines to the processing system's port."""
    windows: list[Window] = [domain.aperture, *(engine.window for engine in engines)]
    connections: dict[str, str | None] = {"clk": f"clk_{domain.clock}", "resetn": f"resetn_{domain.clock}"}
    for signal, _, width in LITE:
        connections[f"s_{signal}"] = net.wire(f"ps_{signal}", width)
        share = width if signal in SHARED else PER_SLAVE.get(signal, 1)
        lanes = width if signal in SHARED else len(windows) * share
        connections[f"m_{signal}"] = net.wire(f"registers_{signal}", lanes)
    for signal, direction, width in LITE:
        mine = f"registers_{signal}" if signal in SHARED else f"registers_{signal}[{width - 1}:0]"
        given = direction.value == "in"
        net.assign(f"{prefix}{signal}", mine) if given else net.assign(mine, f"{prefix}{signal}")
    parameters = {
        "COUNT": len(windows),
        "ADDR_WIDTH": 32,
        "BASE": concat(f"32'h{window.base:08X}" for window in reversed(windows)),
        "MASK": concat(f"32'h{0xFFFF_FFFF & ~(window.size - 1):08X}" for window in reversed(windows)),
    }
    net.instance("cm_axil_interconnect", "registers", connections, parameters, "Static part and DMA engines")


def _engine(net: Netlist, system: System, engine: Engine, slave: int, ports: Mapping[str, int]) -> None:
    pins: dict[str, str | None] = {"clk": f"clk_{engine.clock}", "resetn": f"resetn_{engine.clock}"}
    for signal, _, _ in LITE:
        if signal in ("awprot", "arprot", "wstrb"):
            continue
        width = PER_SLAVE.get(signal, 1)
        share = f"registers_{signal}[{slave * width}+:{width}]"
        pins[f"s_axi_{signal}"] = f"registers_{signal}" if signal in SHARED else share
    parameters: dict[str, object] = {"LENGTH_BITS": engine.length_bits, "DATA_BYTES": WORD}
    for way, half in ((Direction.MM2S, READ), (Direction.S2MM, WRITE)):
        parameters[f"HAS_{way.value.upper()}"] = int(way in engine.directions)
        asked = {name: None for name, _ in half.asks}
        idle = {name: f"{{{width}{{1'b0}}}}" for name, width in half.answers}
        for name, value in (asked | idle).items():
            pins[f"m_axi_{name}"] = value
        pins[f"{way.value}_introut"] = None
    pins |= _idle_streams()
    for dma in engine.channels:
        parameters |= dict(_channel(net, system, dma, pins, ports))
    net.instance("cm_axi_dma", f"dma_{engine.name}", pins, parameters, f"Registers at {engine.window.base:#010x}")


def _idle_streams() -> dict[str, str | None]:
    sending: dict[str, str | None] = {f"m_axis_{name}": None for name in STREAM}
    receiving: dict[str, str | None] = {f"s_axis_{name}": "1'b0" for name in STREAM}
    receiving["s_axis_tdata"] = "8'd0"
    return sending | receiving | {"m_axis_tready": "1'b0", "s_axis_tready": None}


def _channel(
    net: Netlist, system: System, dma: Dma, pins: dict[str, str | None], ports: Mapping[str, int]
) -> Iterator[tuple[str, object]]:
    """Connect a channel (half a memory port, stream, interrupt), and return its parameters."""
    way = dma.direction.value
    half, stream = (READ, "m_axis") if dma.sends else (WRITE, "s_axis")
    number = halves(system)[dma.direction].index(dma)
    for name, width in (*half.asks, *half.answers):
        pins[f"m_axi_{name}"] = net.wire(memory_pin(number, name), width)
    pins[f"{way}_introut"] = net.wire(f"irq_{dma.name}")
    for signal in STREAM:
        port = f"axis_{dma.name}_{signal}"
        missing = None if dma.sends else ones(dma.width // 8)  # a region without TKEEP
        pins[f"{stream}_{signal}"] = port if port in ports else missing
    yield f"{way.upper()}_BYTES", dma.width // 8
    if not dma.sends:
        yield "S2MM_LAST", int(_ends(_bus(system, dma)))


def _bus(system: System, dma: Dma) -> StreamBus:
    return next(bus for bus in system.streams if bus.dma == dma)


def _ends(bus: StreamBus) -> bool:
    """Whether a stream to memory marks where its packets end; a switch's always does."""
    return "TLAST" in bus.interface.ports or not bus.interface.ports
