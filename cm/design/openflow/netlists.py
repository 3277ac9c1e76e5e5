# SPDX-License-Identifier: Apache-2.0
"""Verilog that only this flow needs: the top, both sides of a region's anchors, processing system and DMA engines.

Each side of the anchors is placed with a harness of flip-flops behind them, so that timing paths begin and end there;
the harness is left out of the bitstreams.

The processing system of a Zynq-7000 stands in place of the block design that needs the vendor's tool. It has one clock,
its reset, one master port as AXI4-Lite, interrupts, and as many memory ports (HP0 to HP3: AXI3, 64 bits) as the DMA
engines need. DDR and MIO pins are dedicated to it and need no wires here.

DMA engines are ``cm_axi_dma.v``, between the processing system and the streams. Each stream from memory has the read
half of a memory port to itself, and each stream to memory the write half of one: no arbitration is needed, and there
are four of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from cm.design.generate.axi import LITE, PER_SLAVE, SHARED, decoded
from cm.design.generate.static_part.module import static_part
from cm.design.generate.verilog_module import Netlist, concat, ones, zeros
from cm.design.generate.wrapper import black_box
from cm.design.hdl.model import PortDirection
from cm.design.openflow.layout import BoundaryBit, boundary_bits
from cm.design.plan.addresses import Window
from cm.design.plan.dma_engines import Dma, Engine
from cm.design.plan.system import Domain, RegionPlan, StreamBus, System
from cm.schema.model import Direction

IN, OUT = PortDirection.IN, PortDirection.OUT
INTERRUPTS = 16  # of the PL
MEMORY_PORTS = 4
WORD = 8  # bytes, of a memory port

Pins = tuple[tuple[str, int], ...]
_FROM_GP: Pins = (
    *(("awaddr", 32), ("awid", 12), ("awvalid", 1), ("wdata", 32), ("wstrb", 4), ("wlast", 1), ("wvalid", 1)),
    *(("bready", 1), ("araddr", 32), ("arid", 12), ("arlen", 4), ("arvalid", 1), ("rready", 1)),
)
_TO_GP: Pins = (
    *(("awready", 1), ("wready", 1), ("bid", 12), ("bresp", 2), ("bvalid", 1), ("arready", 1)),
    *(("rdata", 32), ("rid", 12), ("rresp", 2), ("rlast", 1), ("rvalid", 1)),
)


@dataclass(frozen=True, slots=True)
class Half:
    """The read or the write half of a memory port, as seen by its master."""

    asks: Pins
    answers: Pins
    constants: tuple[tuple[str, str], ...]  # words of 64 bits, rising addresses, bufferable


READ = Half(
    (("araddr", 32), ("arlen", 4), ("arvalid", 1), ("rready", 1)),
    (("arready", 1), ("rdata", 64), ("rresp", 2), ("rlast", 1), ("rvalid", 1)),
    (("arsize", "2'b11"), ("arburst", "2'b01"), ("arcache", "4'b0011")),
)
WRITE = Half(
    (
        *(("awaddr", 32), ("awlen", 4), ("awvalid", 1)),
        *(("wdata", 64), ("wstrb", 8), ("wlast", 1), ("wvalid", 1), ("bready", 1)),
    ),
    (("awready", 1), ("wready", 1), ("bresp", 2), ("bvalid", 1)),
    (("awsize", "2'b11"), ("awburst", "2'b01"), ("awcache", "4'b0011")),
)


def memory_pin(number: int, signal: str) -> str:
    """The port of ``cm_open_system`` for a signal of a memory port."""
    return f"s_axi_hp{number}_{signal}"


def processing_system(reads: int, writes: int) -> Netlist:
    """``cm_open_system`` with the read halves of the first `reads` memory ports and the write halves of `writes`."""
    net = Netlist("cm_open_system", "The processing system for the open flow: clock, registers, memory, interrupts.")
    net.port("clk", OUT)
    net.port("resetn", OUT)
    net.port("irq", IN, INTERRUPTS)
    for name, direction, width in LITE:  # seen from the static part there
        net.port(f"m_axi_{name}", OUT if direction is IN else IN, width)
    net.wire("fclk", 4)
    net.wire("fresetn", 4)
    net.unused += ["fclk[3:1]", "fresetn[3:1]"]
    pins: dict[str, str | None] = {"FCLKCLK": "fclk", "FCLKRESETN": "fresetn", "IRQF2P": f"{{{zeros(4)}, irq}}"}
    pins["MAXIGP0ACLK"] = "clk"
    bridge: dict[str, str | None] = {"clk": "clk", "resetn": "resetn"}
    for name, width in (*_FROM_GP, *_TO_GP):
        pins[f"MAXIGP0{name.upper()}"] = bridge[f"s_{name}"] = net.wire(f"gp_{name}", width)
    bridge |= {f"m_{name}": f"m_axi_{name}" for name, _, _ in LITE}
    for number in range(max(reads, writes)):
        pins[f"SAXIHP{number}ACLK"] = "clk"
    for half, count in ((READ, reads), (WRITE, writes)):
        for number in range(count):
            pins |= _half(net, half, number)
    net.instance("PS7", "ps7", pins)
    net.instance("BUFG", "cm_clock_buffer", {"I": "fclk[0]", "O": "clk"})
    reset: dict[str, str | None] = {"clk": "clk", "d": "fresetn[0]", "q": "resetn"}
    net.instance("cm_sync", "sync_reset", reset, {"WIDTH": 1}, "The fabric's reset falls at any time")
    net.instance("cm_gp_lite", "bridge", bridge)
    return net


def _half(net: Netlist, half: Half, number: int) -> dict[str, str | None]:
    """Make half a port a port of the netlist, and return its pins."""
    pins: dict[str, str | None] = {f"SAXIHP{number}{name.upper()}": value for name, value in half.constants}
    for direction, listed in ((IN, half.asks), (OUT, half.answers)):
        for name, width in listed:
            pins[f"SAXIHP{number}{name.upper()}"] = net.port(memory_pin(number, name), direction, width)
    return pins


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
    spi = system.platform.spi
    lines = {spi(0): "irq"} | {spi(dma.line): f"irq_{dma.name}" for dma in system.dmas}
    net.assign(net.wire("irq_lines", INTERRUPTS), _wires(system, lines))


def _wires(system: System, by_spi: Mapping[int, str]) -> str:
    """All wires of interrupts, of which only those in `by_spi` carry a signal."""
    return concat(by_spi.get(spi, "1'b0") for _, spi in reversed(system.platform.irq_wires))


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
    net.instance("cm_axil_interconnect", "registers", connections, decoded(windows), "Static part and DMA engines")


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
        yield "S2MM_LAST", int(_bus(system, dma).ends)


def _bus(system: System, dma: Dma) -> StreamBus:
    return next(bus for bus in system.streams if bus.dma == dma)


TOP, MODULE_TOP = "cm_open_top", "cm_open_module"
ANCHOR, HARNESS = "cm_anchor_", "cm_harness_"


def bits_of_region(region: RegionPlan) -> tuple[BoundaryBit, ...]:
    """The wires that cross a region's boundary."""
    return boundary_bits(region, black_box(region).ports)


def open_top(system: System) -> Netlist:
    """``cm_open_top``: the generated static part and its DMA engines on a processing system without a block design."""
    static = static_part(system)
    net = Netlist(TOP, f"Top of {system.project.name} for the open flow: processing system and static part.")
    (domain,) = system.domains
    inner: dict[str, str | None] = {}
    outer: dict[str, str | None] = {"clk": f"clk_{domain.clock}", "resetn": f"resetn_{domain.clock}"}
    prefix = f"s_axi_{domain.clock}_"
    within = {f"clk_{domain.clock}", f"resetn_{domain.clock}", "irq"}
    within |= {f"axis_{dma.name}_{signal}" for dma in system.dmas for signal in STREAM}
    for port in static.ports:
        inner[port.name] = port.name
        if port.name in within or port.name.startswith(prefix):
            net.wire(port.name, port.width)
        else:
            assert port.direction is not None
            net.port(port.name, port.direction, port.width)
    channels = halves(system)
    if system.engines:
        add_engines(net, system, {port.name: port.width for port in static.ports})
        outer |= {f"m_axi_{name}": f"ps_{name}" for name, _, _ in LITE} | {"irq": "irq_lines"}
    else:
        outer |= {f"m_axi_{name}": f"{prefix}{name}" for name, _, _ in LITE}
        outer["irq"] = _wires(system, {system.platform.spi(0): "irq"})
    for way, half in ((Direction.MM2S, READ), (Direction.S2MM, WRITE)):
        for number in range(len(channels[way])):
            outer |= {memory_pin(number, name): memory_pin(number, name) for name, _ in (*half.asks, *half.answers)}
    net.instance("cm_open_system", "system", outer)
    net.instance("cm_static", "static_part", inner)
    return net


def open_system(system: System) -> Netlist:
    """``cm_open_system``: the processing system with the ports to memory that the design's streams need."""
    channels = halves(system)
    return processing_system(len(channels[Direction.MM2S]), len(channels[Direction.S2MM]))


def static_side(region: RegionPlan) -> Netlist:
    """The region as it is placed with the static part: anchors, and the harness in place of the modules."""
    net = black_box(region)
    net.black_box = False
    net.doc = f"Region {region.name}: anchors of its boundary, and flip-flops in the place of a module."
    bits = bits_of_region(region)
    _harness_clock(net, region)
    for number, clock in enumerate(region.clocks):  # so that it reaches the region's rows, whatever is placed there
        _flip_flop(net, f"{HARNESS}{region.index}_spine{number}", "cm_toggle", None, clock)
    for bit in bits:
        if bit.into:
            _arrives(net, bit, bit.signal)
        else:
            _departs(net, bit, bit.signal)
    return net


def module_side(region: RegionPlan) -> Netlist:
    """``cm_open_module``: a module's wrapper behind the anchors, and the harness in place of the static part."""
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
    """End a signal: an anchor, a look-up table that keeps the tools from packing it, and a flip-flop."""
    anchored, hop = net.wire(f"cm_a{bit.label}"), net.wire(f"cm_h{bit.label}")
    _lut(net, f"{ANCHOR}{bit.label}", signal, anchored)
    _lut(net, f"{HARNESS}{bit.label}_lut", anchored, hop)
    _flip_flop(net, f"{HARNESS}{bit.label}_ff", hop, None)


def _departs(net: Netlist, bit: BoundaryBit, signal: str) -> None:
    """Begin a signal: a flip-flop, then the anchor."""
    begun = net.wire(f"cm_b{bit.label}")
    _flip_flop(net, f"{HARNESS}{bit.label}_ff", "cm_toggle", begun)
    _lut(net, f"{ANCHOR}{bit.label}", begun, signal)


def _harness_clock(net: Netlist, region: RegionPlan) -> None:
    """Give the harness its own clock, made by a look-up table, so that its paths can be told apart in reports."""
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
