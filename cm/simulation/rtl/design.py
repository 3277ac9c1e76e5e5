# SPDX-License-Identifier: Apache-2.0
"""A build schema as something to simulate: units to compile, and the wiring around them.

The static part is the one that `cm build` generates, without its regions: their pins are ports of the simulated part,
so that the modules, which are separate libraries, can be exchanged.

MCDMA engines are not simulated. Their channels are ports, ``dma_<channel>_…``, behind the library's own join and
split, with their roles exchanged: they do to streams what the engine does, packets of several channels one after the
other, with TDEST.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.design.generate.generation import load_design
from cm.design.generate.inputs import RTL, library, module_files
from cm.design.generate.outputs import identified, render_identified
from cm.design.generate.static_part.module import static_part
from cm.design.generate.verilog_module import Netlist, Signal, concat
from cm.design.generate.wrapper import wrapper
from cm.design.hdl.model import PortDirection
from cm.design.plan.dma_engines import Dma, Engine, EngineKind
from cm.design.plan.system import Implementation, RegionPlan, StreamBus, System, used_clocks
from cm.design.render import Renderer
from cm.design.runtime.answers import Answers
from cm.frozen import dataclass, replace
from cm.schema.model import Direction
from cm.simulation.rtl.compile import Unit
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.vhdl import as_verilog

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


EVENT_BYTES = 32  # of the pin that shows marks in traces
_HDL = Path(__file__).parent / "hdl"


@dataclass(frozen=True, slots=True)
class StreamEnd:
    """A stream of the static part. `sends`: into the logic. `channel`: its DMA engine's; None: a pin of the device."""

    name: str
    region: str
    sends: bool
    clock: str
    channel: str | None
    prefix: str  # of its ports
    ends: bool  # whether its packets do, by TLAST


@dataclass(frozen=True, slots=True)
class Output:
    """A signal of a region that leaves the device: port of the static part, and what the module calls it."""

    port: str
    region: str
    name: str


@dataclass(frozen=True, slots=True)
class RtlDesign:
    """What runs: `modules` by region and by their name in the runtime schema; `schema` is that schema's text."""

    system: System
    static: Unit
    modules: Mapping[tuple[str, str], Unit]
    streams: tuple[StreamEnd, ...]
    outputs: tuple[Output, ...]
    schema: str

    @property
    def regions(self) -> tuple[str, ...]:
        """Their names, in the order of their numbers."""
        return tuple(region.name for region in self.system.regions)

    @property
    def video(self) -> tuple[str, ...]:
        """Channels of VDMAs, which move frames of lines."""
        engines = (engine for engine in self.system.engines if engine.kind is EngineKind.VDMA)
        names = {dma.name for engine in engines for dma in engine.channels}
        return tuple(end.channel for end in self.streams if end.channel and end.name in names)

    @property
    def clocks(self) -> tuple[str, ...]:
        """Clocks of the static part, in the order of their numbers."""
        return tuple(used_clocks(self.system))


def load_rtl_design(schema: Path, folder: Path) -> RtlDesign:
    """The design of a build schema; generated files are written below `folder`.

    `SchemaError`, `BuildError` or the HDL half's errors where the tree cannot be made, `RtlError` where it cannot
    be simulated.
    """
    system = identified(load_design(schema).system)
    files = render_identified(system, folder, Answers())
    for name, text in files.items():
        _write(folder / name, text)
    static = simulated_static(system)
    renderer = Renderer(system.project.folder, folder, f"Generated from {system.project.source.name} for simulation.")
    _write(folder / "hdl/cm_static_sim.v", renderer.render("module.v.j2", {"net": static}))
    return RtlDesign(
        system,
        Unit("the static part", static.name, _static_sources(system, folder), made=folder),
        {(one.region.name, one.name): _unit(one, folder, renderer) for one in system.implementations},
        tuple(_streams(system)),
        tuple(_outputs(static, system)),
        files[f"config/{system.project.name}.yaml"],
    )


def simulated_static(system: System) -> Netlist:
    """``cm_static`` with the pins of its regions as ports called ``<region>_<pin>``."""
    net = static_part(system)
    regions = {region.module: region for region in system.regions}
    for instance in [one for one in net.instances if one.module in regions]:
        net.instances.remove(instance)
        directions = _directions(regions[instance.module])
        for pin, wire in instance.connections.items():
            direction, width = directions[pin]
            if direction is PortDirection.INOUT or wire is None:
                continue  # goes to a pin of the device, which is not simulated here
            net.wires[:] = [other for other in net.wires if other.name != wire]
            net.ports.append(Signal(wire, width, IN if direction is OUT else OUT))
    add_engines(net, system)
    net.unused.append(net.port("cm_event", IN, 8 * EVENT_BYTES))
    return net


def wiring(design: RtlDesign, static: Path, seed: int) -> str:
    """The lines that the harness reads: see `Harness::wire`."""
    return "\n".join(_wiring(design, static, seed)) + "\n"


def _wiring(design: RtlDesign, static: Path, seed: int) -> Iterator[str]:
    system, clocks = design.system, list(design.clocks)
    yield f"static {seed} {static}"
    for name in clocks:
        yield f"clock {name} {round(1e12 / system.project.clocks[name].rate)}"
    for domain in system.domains:
        windows = " ".join(f"{window.base} {window.end}" for window in domain.windows)
        yield f"bus s_axi_{domain.clock} {clocks.index(domain.clock)} {windows}"
    for stream in design.streams:
        kind = "source" if stream.sends else "sink" if stream.channel else "drain"
        ends = f" {stream.ends:d}" if kind == "sink" else ""
        yield f"{kind} {stream.prefix} {clocks.index(stream.clock)}{ends}"
    for region in system.regions:
        for interface in region.memory:
            yield f"memory m_axi_{region.name}_{interface.name} {clocks.index(region.clock_of(interface))}"
    if system.icap:
        yield f"port axis_icap {clocks.index(system.icap.clock)} 1"
    if system.readback:
        yield f"drain axis_{system.readback.name} {clocks.index(system.readback.clock)}"
    for output in design.outputs:
        yield f"output {output.port}"
    for region in system.regions:
        pins = " ".join(f"{pin} {clocks.index(name)}" for pin, name in _clock_pins(region))
        yield f"region {region.name} {region.name}_ {pins}"


def _clock_pins(region: RegionPlan) -> Iterator[tuple[str, str]]:
    for pin, name in region.clocks.items():
        if name == "external":
            raise RtlError(f"region {region.name}: its clock {pin} comes from outside, which nothing here drives")
        yield pin, name or region.spec.clock


def _directions(region: RegionPlan) -> dict[str, tuple[PortDirection, int]]:
    found = {port.name: (port.direction, port.width) for port in region.boundary.ports}
    return found | {"cm_identity": (OUT, 32)}


def _streams(system: System) -> Iterator[StreamEnd]:
    """Streams of DMA engines and outside sources come first, as they have numbers; `drain` has none."""
    ends = [
        _stream(region.name, region.clock_of(b.interface), b)
        for region in system.regions
        for b in region.streams
        if not b.switched
    ]
    ends += [_stream("", system.switch.clock, bus) for bus in system.switch.streams] if system.switch else []
    yield from (end for end in ends if end.sends or end.channel)
    yield from (end for end in ends if not (end.sends or end.channel))


def _stream(region: str, own: str, bus: StreamBus) -> StreamEnd:
    sends = bus.interface.mode.value == "slave"
    clock = bus.dma.clock if bus.dma else own
    channel = bus.spec.stream or bus.name if bus.dma else None
    if bus.dma and (bus.dma.direction is Direction.MM2S) != sends:
        raise RtlError(f"{bus.name}: its DMA engine goes the other way")
    prefix = prefix_of(bus.dma) if bus.dma else f"axis_{bus.name}"
    return StreamEnd(bus.name, region, sends, clock, channel, prefix, bus.ends)


def _outputs(static: Netlist, system: System) -> Iterator[Output]:
    ports = {port.name for port in static.ports if port.direction is OUT}
    for region in system.regions:
        for port in region.external:
            name = f"ext_{region.name}_{port.name}"
            if port.direction is OUT and port.width <= 64 and name in ports:
                yield Output(name, region.name, port.name)


def _static_sources(system: System, folder: Path) -> tuple[Path, ...]:
    return (folder / "hdl/cm_static_sim.v", *library(system), *sorted(_HDL.glob("*.*v")))


def _unit(one: Implementation, folder: Path, renderer: Renderer) -> Unit:
    """A module in its wrapper; where vendor IP is used, `sim_sources` stand for it."""
    module = one.module
    if (module.ip or module.tcl) and not module.sim_sources:
        raise RtlError(
            f"module {module.name} is made of vendor IP or C++: give sim_sources: with HDL that does the same"
        )
    if module.sim_sources:
        module = replace(module, sources=module.sim_sources, libraries={})
    files = module_files(replace(one, module=module), folder)
    sources = tuple(dict.fromkeys([*files["verilog"], *files["systemverilog"]]))
    if files["vhdl"] or module.libraries:
        sources = _of_vhdl(replace(one, module=module), folder, renderer)
    includes, defines = tuple(files["include_dirs"]), tuple(files["defines"])
    return Unit(f"module {one.name}", one.region.module, sources, includes, defines, folder)


def _of_vhdl(one: Implementation, folder: Path, renderer: Renderer) -> tuple[Path, ...]:
    """The module as Verilog, its generics in it, and a wrapper that sets none."""
    module = one.module
    for source in module.sources:
        if source.suffix.lower() not in (".vhd", ".vhdl"):
            raise RtlError(
                f"module {module.name} is in two languages: VHDL is brought to Verilog whole ({source.name})"
            )
    plain = replace(one, module=replace(module, parameters={}))
    path = folder / f"wrappers/{one.name}/{one.region.module}.v"
    _write(path, renderer.render("module.v.j2", {"net": wrapper(plain)}))
    flat = [folder / f"wrappers/{one.name}/{module.flat[0]}"] if module.flat else []
    return (path, as_verilog(module, (*module.sources, *flat)), *sorted(RTL.glob("cm_axi_slave_decoupler*.v")))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
