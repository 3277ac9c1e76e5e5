# SPDX-License-Identifier: Apache-2.0
"""Plans what the interfaces, interrupts and single signals of a region are connected to."""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.boundary.model import Boundary, BoundaryPort, Role
from cm.design.hdl.model import Interface, Mode, PortDirection
from cm.design.plan.addresses import Allocator
from cm.design.plan.streams import stream_bus
from cm.design.plan.switch import check_switched
from cm.design.plan.system import Line, RegionPlan, RegisterBus, StreamBus, clock_of
from cm.design.project.model import ConnectionSpec, Project, RegionSpec
from cm.design.project.source_position import fault
from cm.frozen import dataclass, field
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


@dataclass(slots=True)
class _Region:
    """A region while its parts are collected."""

    registers: list[RegisterBus] = field(default_factory=list)
    streams: list[StreamBus] = field(default_factory=list)
    memory: list[Interface] = field(default_factory=list)
    external: list[BoundaryPort] = field(default_factory=list)
    unused: list[BoundaryPort] = field(default_factory=list)
    undecided: list[BoundaryPort] = field(default_factory=list)  # single signals that the build schema does not mention


class RegionPlanner:
    """Plans regions one after another; `bits`: the interrupts so far; `notes`: what a designer should know.

    `width`: of the stream switch.
    """

    def __init__(self, project: Project, addresses: Allocator, width: int) -> None:
        self._project, self._addresses, self._width = project, addresses, width
        self.bits = 0
        self.notes: list[str] = []

    def plan(self, index: int, spec: RegionSpec, boundary: Boundary) -> RegionPlan:
        """Plan a region with everything around it, except DMA engines, which it may share with other regions."""
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
        for direction, text in ((PortDirection.IN, "driven by nothing, and 0"), (PortDirection.OUT, "read by nothing")):
            names = [port.name for port in parts.undecided if port.direction is direction]
            hint = "`connect: external` under the region's interfaces brings one to a port of the top"
            self.notes += [f"{spec.name}: {', '.join(names)}: of no interface, {text}; {hint}"] if names else []
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
            parts.streams.append(self._stream(region, interface, spec, clock_of(region, boundary, interface)))
        elif connect == "switch":
            check_switched(self._project, region, interface)
            parts.streams.append(StreamBus(interface, f"{region.name}_{interface.name}", None, spec, self._width))
        elif connect == "interconnect":
            parts.registers.append(self._registers(region, interface, clock_of(region, boundary, interface)))
        elif connect == "memory":
            parts.memory.append(interface)
        elif connect == "external" and interface.protocol == "axis":
            parts.streams.append(StreamBus(interface, f"{region.name}_{interface.name}", None, spec))
        else:
            ports = [port for port in boundary.ports if port.interface == interface.name]
            (parts.external if connect == "external" else parts.unused).extend(ports)

    def _stream(self, region: RegionSpec, interface: Interface, spec: ConnectionSpec, clock: str) -> StreamBus:
        if interface.mode is Mode.MASTER and "TLAST" not in interface.ports:
            self.notes.append(
                f"{region.name}.{interface.name} has no TLAST: its DMA ends a transfer only when the buffer is full"
            )
        return stream_bus(self._project, region, interface, spec, clock)

    def _registers(self, region: RegionSpec, interface: Interface, clock: str) -> RegisterBus:
        name = f"{region.name}_{interface.name}"
        bits = interface.addr_width or 12
        size = max(region.window, 1 << min(bits, 32)) if bits > 16 and interface.protocol == "axi4" else region.window
        if bits < 32 and (1 << bits) > size:
            self.notes.append(f"{name} decodes {bits} address bits; its window shows {size:#x} bytes of them")
        if interface.protocol == "axi4" or interface.data_width != 32:
            return RegisterBus(interface, self._addresses.wide(name, min(size, 1 << 24)), full=True)
        return RegisterBus(interface, self._addresses.registers(name, size, clock))

    def _single(
        self, region: RegionSpec, port: BoundaryPort, boundary: Boundary, lines: list[Line], parts: _Region
    ) -> None:
        """Plan a port that belongs to no bus."""
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
                parts.undecided.append(port)
        (parts.external if connect == "external" else parts.unused).append(port)

    def _interrupts(self, region: RegionSpec, port: BoundaryPort, boundary: Boundary) -> Iterator[Line]:
        several = len(self._project.regions) > 1
        own = _name_in_modules(port, boundary)
        for index in range(port.width):
            name = f"{region.name}_{own}" if several else own
            if port.width > 1:
                name += f"_{index}"
            # a pulse of one clock must not be missed, so interrupts are edge-triggered
            yield Line(name, port.name, index, self.bits, edge=True)
            self.bits += 1


def _name_in_modules(port: BoundaryPort, boundary: Boundary) -> str:
    """The modules' name for `port` if they agree, as the boundary may have given it a plainer name."""
    names = {
        connection.module
        for adaptation in boundary.adaptations
        for connection in adaptation.connections
        if connection.boundary == port.name and connection.module
    }
    return names.pop() if len(names) == 1 else port.name


def _outer_clocks(spec: RegionSpec, boundary: Boundary) -> Iterator[BoundaryPort]:
    """Clocks that come in through ports of the top."""
    for port in boundary.ports:
        if port.role is Role.CLOCK and spec.clocks.get(port.name) == "external":
            yield port


def _key(region: RegionSpec, interface: str) -> KeyPath:
    return ("regions", region.name, "interfaces", interface)
