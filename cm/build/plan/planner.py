# SPDX-License-Identifier: Apache-2.0
"""Project and boundaries → `cm.build.plan.system.System`: connections, addresses, interrupt lines, runs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from cm.build.boundary.model import Boundary, BoundaryPort, Role
from cm.build.errors import BuildError
from cm.build.hdl.model import Interface, Mode, PortDirection
from cm.build.plan.addresses import CONTROL_SIZE, Allocator
from cm.build.plan.cover import Cover, cover
from cm.build.plan.engines import Dma
from cm.build.plan.frames import check_frames
from cm.build.plan.shells import check_shells, first_run
from cm.build.plan.streams import crowding, place, stream_bus
from cm.build.plan.switch import check_switched, own_streams, plan_switch, switch_width
from cm.build.plan.system import (
    Domain,
    Implementation,
    Line,
    MemoryBus,
    RegionPlan,
    RegisterBus,
    StreamBus,
    SwitchPlan,
    System,
)
from cm.build.plan.window import Window
from cm.build.platforms import Platform, device_of, platform_of
from cm.build.project.model import ConnectionSpec, Project, RegionSpec
from cm.build.project.where import fault
from cm.schema.model import Direction, LoaderKind
from cm.schema.problems import KeyPath, did_you_mean

_CONNECTIONS = {
    ("axis", Mode.SLAVE): ("dma", "vdma", "switch", "external", "none"),
    ("axis", Mode.MASTER): ("dma", "vdma", "switch", "external", "none"),
    ("axis", Mode.MONITOR): ("none",),
    ("axi4lite", Mode.SLAVE): ("interconnect", "none"),
    ("axi4", Mode.SLAVE): ("interconnect", "none"),
    ("axi4lite", Mode.MASTER): ("memory", "none"),
    ("axi4", Mode.MASTER): ("memory", "none"),
}
_OTHER = ("external", "none")


def plan_system(project: Project, boundaries: Mapping[str, Boundary]) -> System:
    """The system around `project`'s regions; BuildError where something cannot be connected."""
    return _Planner(project).plan(boundaries)


@dataclass(slots=True)
class _Region:
    """A region while its parts are collected."""

    registers: list[RegisterBus] = field(default_factory=list)
    streams: list[StreamBus] = field(default_factory=list)
    memory: list[MemoryBus] = field(default_factory=list)
    external: list[BoundaryPort] = field(default_factory=list)
    unused: list[BoundaryPort] = field(default_factory=list)
    undecided: list[str] = field(default_factory=list)  # single signals that the build schema says nothing of


class _Planner:
    def __init__(self, project: Project) -> None:
        self._project = project
        self._platform: Platform = platform_of(project.part)
        self._addresses = Allocator(self._platform.base, self._platform.size, tuple(project.clocks))
        self._bits = 0
        self._width = 0  # of the stream switch
        self._notes: list[str] = []

    def plan(self, boundaries: Mapping[str, Boundary]) -> System:
        project = self._project
        main = next(iter(project.clocks))
        self._check_coherence()
        check_shells(project, self._platform)
        control = self._addresses.control(main)
        icap = self._icap(main)
        self._width = switch_width(project, _switched(project, boundaries))
        regions = tuple(
            self._region(index, region, boundaries[region.name])
            for index, region in enumerate(project.regions.values())
        )
        self._check_lines()
        own = own_streams(project, self._width) if project.switch else ()
        regions, own, icap = place(project, regions, own, icap, self._addresses, self._platform.irq_count)
        self._notes += crowding(regions, own, self._platform.irq_count)
        switch = self._switch(regions, own)
        check_frames(project, regions, switch)
        covered = self._cover()
        return System(
            project=project,
            platform=self._platform,
            device=device_of(project.part),
            regions=regions,
            domains=self._domains(),
            control=control,
            icap=icap,
            implementations=tuple(self._implementations(regions)),
            runs=tuple(self._names(run) for run in covered.runs),
            cover=covered,
            notes=tuple(self._notes),
            switch=switch,
        )

    def _switch(self, regions: tuple[RegionPlan, ...], own: tuple[StreamBus, ...]) -> SwitchPlan | None:
        if self._project.switch is None:
            return None
        window = self._addresses.registers("switch", CONTROL_SIZE, self._project.switch.clock)
        return plan_switch(self._project, regions, window, own)

    def _check_coherence(self) -> None:
        """Only UltraScale+ has coherent ports as wide as those that the block design uses."""
        if self._project.static.coherent and not self._platform.coherent_slaves:
            message = f"{self._platform.name} has no coherent port that the generated block design uses"
            hint = "leave it away: the DMA goes through HP ports then, and the runtime syncs each frame"
            raise fault(self._project.source, ("static", "coherent"), message, hint)
        if self._project.static.coherent:
            self._notes.append(
                "HPC ports snoop only with broadcasting on: the boot loader has to write 3 to LPD_SLCR.lpd_apu "
                "(0xff41a040) before the processors start, a [init] file of bootgen does (UG1085)"
            )

    def _icap(self, clock: str) -> Dma | None:
        if not any(region.loader in (LoaderKind.ICAP, LoaderKind.AUTO) for region in self._project.regions.values()):
            return None
        rate, limit = self._project.clocks[clock].rate, self._platform.icap_rate_max
        if rate > limit:
            message = f"the ICAP runs on {clock} at {rate} Hz; {self._platform.name} allows {limit} Hz"
            hint = "list a slower clock first, or give regions another loader"
            raise fault(self._project.source, ("clocks", clock, "rate"), message, hint)
        return Dma("icap", Direction.MM2S, Window("", 0, 0), -1, clock, 32)

    def _check_lines(self) -> None:
        if self._bits > 32:
            raise BuildError(f"the modules have {self._bits} interrupts, the concentrator holds 32")

    def _region(self, index: int, spec: RegionSpec, boundary: Boundary) -> RegionPlan:
        names = [interface.name for interface in boundary.interfaces]
        names += [port.name for port in boundary.ports if port.role in (Role.INTERRUPT, Role.SIGNAL)]
        for name in spec.interfaces:
            if name not in names:
                message = f"region {spec.name} has no interface {name!r}"
                raise fault(self._project.source, _key(spec, name), message, did_you_mean(name, names))
        parts = _Region()
        for interface in boundary.interfaces:
            self._interface(spec, interface, boundary, parts)
        lines: list[Line] = []
        for port in boundary.ports:
            self._single(spec, port, boundary, lines, parts)
        if parts.undecided:
            self._notes.append(
                f"{spec.name}: {', '.join(parts.undecided)} belong to no interface and are not connected "
                "(inputs are 0); `connect: external` under the region's interfaces brings one to a port of the top"
            )
        return RegionPlan(
            spec,
            index,
            boundary,
            tuple(parts.registers),
            tuple(parts.streams),
            tuple(parts.memory),
            tuple(lines),
            (*parts.external, *_outer_clocks(spec, boundary)),
            tuple(parts.unused),
        )

    def _interface(self, region: RegionSpec, interface: Interface, boundary: Boundary, parts: _Region) -> None:
        spec = region.interfaces.get(interface.name, ConnectionSpec())
        if interface.protocol == "axi3":
            message = f"{region.name}.{interface.name} is AXI3"
            hint = "put an AXI3 to AXI4 converter into the module"
            raise fault(self._project.source, _key(region, interface.name), message, hint)
        allowed = _CONNECTIONS.get((interface.protocol, interface.mode), _OTHER)
        connect = spec.connect or allowed[0]
        if connect not in allowed:
            kind = f"{interface.protocol} {interface.mode.value}"
            message = f"{region.name}.{interface.name} ({kind}) cannot be connected to {connect}"
            key = (*_key(region, interface.name), "connect")
            raise fault(self._project.source, key, message, f"write {' or '.join(allowed)}")
        if connect in ("dma", "vdma"):
            parts.streams.append(self._stream(region, interface, spec))
        elif connect == "switch":
            check_switched(self._project, region, interface)
            parts.streams.append(StreamBus(interface, f"{region.name}_{interface.name}", None, spec, self._width))
        elif connect == "interconnect":
            parts.registers.append(self._registers(region, interface))
        elif connect == "memory":
            parts.memory.append(MemoryBus(interface))
        elif connect == "external" and interface.protocol == "axis":
            parts.streams.append(StreamBus(interface, f"{region.name}_{interface.name}", None, spec))
        else:
            ports = [port for port in boundary.ports if port.interface == interface.name]
            (parts.external if connect == "external" else parts.unused).extend(ports)

    def _stream(self, region: RegionSpec, interface: Interface, spec: ConnectionSpec) -> StreamBus:
        if interface.mode is Mode.MASTER and "TLAST" not in interface.ports:
            self._notes.append(
                f"{region.name}.{interface.name} has no TLAST: its DMA ends a transfer only when the buffer is full"
            )
        return stream_bus(self._project, region, interface, spec)

    def _registers(self, region: RegionSpec, interface: Interface) -> RegisterBus:
        name = f"{region.name}_{interface.name}"
        bits = interface.addr_width or 12
        size = max(region.window, 1 << min(bits, 32)) if bits > 16 and interface.protocol == "axi4" else region.window
        if bits < 32 and (1 << bits) > size:
            self._notes.append(f"{name} decodes {bits} address bits; its window shows {size:#x} bytes of them")
        if interface.protocol == "axi4" or interface.data_width != 32:
            return RegisterBus(interface, self._addresses.wide(name, min(size, 1 << 24)), full=True)
        return RegisterBus(interface, self._addresses.registers(name, size, region.clock))

    def _single(
        self, region: RegionSpec, port: BoundaryPort, boundary: Boundary, lines: list[Line], parts: _Region
    ) -> None:
        """Ports that belong to no bus."""
        if port.role is Role.INTERRUPT and port.direction is PortDirection.OUT:
            connect = region.interfaces.get(port.name, ConnectionSpec()).connect or "interrupt"
            if connect == "interrupt":
                lines.extend(self._interrupts(region, port, boundary))
                return
        elif port.role not in (Role.INTERRUPT, Role.SIGNAL) or port.interface:
            return
        else:
            connect = region.interfaces.get(port.name, ConnectionSpec()).connect or "none"
            if port.name not in region.interfaces:
                parts.undecided.append(port.name)
        (parts.external if connect == "external" else parts.unused).append(port)

    def _interrupts(self, region: RegionSpec, port: BoundaryPort, boundary: Boundary) -> Iterator[Line]:
        several = len(self._project.regions) > 1
        own = _name_in_modules(port, boundary)
        for index in range(port.width):
            name = f"{region.name}_{own}" if several else own
            if port.width > 1:
                name += f"_{index}"
            # one clock of a module must not be missed, so a rising edge is what counts
            yield Line(name, port.name, index, self._bits, edge=True)
            self._bits += 1

    def _domains(self) -> tuple[Domain, ...]:
        domains: list[Domain] = []
        for name, windows in self._addresses.domains():
            aperture = self._addresses.aperture(name)
            domains.append(Domain(name, len(domains), self._project.clocks[name].rate, aperture, windows))
        return tuple(domains)

    def _cover(self) -> Cover:
        project = self._project
        if project.static.abstract_shells:
            return first_run(project)
        regions = {name: [module.name for module in project.modules_of(name)] for name in project.regions}
        modes = [mode.modules for mode in project.modes.values()]
        first = project.modes[project.default_mode].modules
        found = cover(regions, modes, not project.modes_given, first)
        for region, module in found.left_out:
            self._notes.append(f"{module} in {region} is in no mode: it is synthesised, but in no implementation run")
        return found

    def _implementations(self, regions: tuple[RegionPlan, ...]) -> Iterator[Implementation]:
        for region in regions:
            for module in self._project.modules_of(region.name):
                yield Implementation(module, region, identity_of(self._project.name, region.name, module.name))

    def _names(self, run: Mapping[str, str]) -> dict[str, str]:
        """Region → name of the implementation."""
        return {
            region: module if len(self._project.modules[module].regions) == 1 else f"{module}_{region}"
            for region, module in run.items()
        }


def _name_in_modules(port: BoundaryPort, boundary: Boundary) -> str:
    """What the modules call `port` where they agree: the boundary may have given it a plainer name."""
    names = {
        connection.module
        for adaptation in boundary.adaptations
        for connection in adaptation.connections
        if connection.boundary == port.name and connection.module
    }
    return names.pop() if len(names) == 1 else port.name


def _switched(project: Project, boundaries: Mapping[str, Boundary]) -> Iterator[Interface]:
    """Interfaces of regions that go to the switch."""
    for region in project.regions.values():
        for interface in boundaries[region.name].interfaces:
            if region.interfaces.get(interface.name, ConnectionSpec()).connect == "switch":
                yield interface


def _outer_clocks(spec: RegionSpec, boundary: Boundary) -> Iterator[BoundaryPort]:
    """Clocks that come in through ports of the top."""
    for port in boundary.ports:
        if port.role is Role.CLOCK and spec.clocks.get(port.name) == "external":
            yield port


def _key(region: RegionSpec, interface: str) -> KeyPath:
    return ("regions", region.name, "interfaces", interface)


def identity_of(project: str, region: str, module: str) -> int:
    """What a module answers in the region's identity register: 31 bits of a hash of its name, never 0."""
    digest = hashlib.sha256(f"{project}/{region}/{module}".encode()).digest()
    return (int.from_bytes(digest[:4], "big") & 0x7FFF_FFFF) | 1
