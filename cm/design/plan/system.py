# SPDX-License-Identifier: Apache-2.0
"""The system that is generated, as frozen data: what is connected to what, at which address and interrupt.

`cm.design.plan.planner.plan_system` makes it from a project and its regions' boundaries; the templates read it.
"""

from __future__ import annotations

from collections.abc import Mapping

from cm.design.boundary.model import Boundary, BoundaryPort, Role
from cm.design.hdl.clock_reset_names import REGION_CLOCK
from cm.design.hdl.model import Interface
from cm.design.plan.addresses import Window
from cm.design.plan.dma_engines import Dma, Engine, engines_of
from cm.design.plan.minimal_runs import Cover
from cm.design.platforms import Platform
from cm.design.project.model import ConnectionSpec, ModuleSpec, Project, RegionSpec
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class RegisterBus:
    """An AXI4-Lite (`full`: AXI4) slave interface of a region, and its window."""

    interface: Interface
    window: Window
    full: bool = False


@dataclass(frozen=True, slots=True)
class StreamBus:
    """An AXI4-Stream interface of a region; if `dma` is None, it goes to ports of the top."""

    interface: Interface
    name: str
    dma: Dma | None
    spec: ConnectionSpec
    switched: int = 0  # bits of the stream switch that it goes to; 0 for none

    @property
    def bytes(self) -> int:
        """Bytes of a beat on the region's side; 0 if there is no TDATA of known width."""
        return -(-(self.interface.data_width or 0) // 8)

    @property
    def converted(self) -> bool:
        """Whether a width converter is between the region and the DMA engine or the switch."""
        return self.width != 0 and self.width != 8 * self.bytes

    @property
    def width(self) -> int:
        """Bits of TDATA on the static side; 0 for ports of the top, which are as wide as the region's."""
        return self.dma.width if self.dma else self.switched

    @property
    def ends(self) -> bool:
        """Whether it marks where its packets end; a switch's always does."""
        return "TLAST" in self.interface.ports or not self.interface.ports

    @property
    def external(self) -> bool:
        """Whether it goes to ports of the top."""
        return self.dma is None and not self.switched

    @property
    def inner(self) -> bool:
        """Whether it ends within the static part: at the switch, or at a port that streams of an engine share."""
        return self.switched > 0 or (self.dma is not None and self.dma.shared)


@dataclass(frozen=True, slots=True)
class SwitchPlan:
    """The stream switch: `streams` come from memory or go there; its ends are named in the order of their numbers."""

    clock: str
    window: Window
    width: int
    streams: tuple[StreamBus, ...]
    sources: Mapping[str, StreamBus]
    sinks: Mapping[str, StreamBus]


@dataclass(frozen=True, slots=True)
class Line:
    """An interrupt line of a region: `bit` of the concentrator."""

    name: str
    port: str
    index: int  # bit of the port
    bit: int
    edge: bool


def clock_sources(spec: RegionSpec, boundary: Boundary) -> dict[str, str | None]:
    """The source of each clock port of a boundary: a clock, ``external``, or None if it is not given.

    The only clock, or `REGION_CLOCK`, is the region's own.
    """
    ports = [port.name for port in boundary.ports if port.role is Role.CLOCK]
    return {
        name: spec.clocks.get(name, spec.clock if len(ports) == 1 or name == REGION_CLOCK else None) for name in ports
    }


def clock_of(spec: RegionSpec, boundary: Boundary, interface: Interface) -> str:
    """The clock on which everything that is connected to an interface runs: its own, or the region's."""
    source = clock_sources(spec, boundary).get(interface.clock or "")
    return source if source and source != "external" else spec.clock


@dataclass(frozen=True, slots=True)
class RegionPlan:
    """A region with everything around it; `index` is its bit in the control registers."""

    spec: RegionSpec
    index: int
    boundary: Boundary
    registers: tuple[RegisterBus, ...] = ()
    streams: tuple[StreamBus, ...] = ()
    memory: tuple[Interface, ...] = ()  # masters to memory
    lines: tuple[Line, ...] = ()
    external: tuple[BoundaryPort, ...] = ()  # to ports of the top
    unused: tuple[BoundaryPort, ...] = ()  # not connected: inputs are 0, outputs open

    @property
    def name(self) -> str:
        """Name of the region."""
        return self.spec.name

    @property
    def clocks(self) -> Mapping[str, str | None]:
        """The source of each clock port of the boundary (`clock_sources`)."""
        return clock_sources(self.spec, self.boundary)

    def clock_of(self, interface: Interface) -> str:
        """The clock on which everything that is connected to an interface runs."""
        return clock_of(self.spec, self.boundary, interface)

    @property
    def cell(self) -> str:
        """The region's cell in the netlist."""
        return f"static_part/{self.name}"

    @property
    def module(self) -> str:
        """Name of the black box, and of every wrapper that takes its place."""
        return f"cm_region_{self.name}"


@dataclass(frozen=True, slots=True)
class Domain:
    """A clock and the register windows that run on it; `aperture` covers them all."""

    clock: str
    index: int
    rate: int
    aperture: Window
    windows: tuple[Window, ...]


@dataclass(frozen=True, slots=True)
class Implementation:
    """A module in a region: one wrapper, one synthesis, one partial bitstream.

    Of a relocatable module the open flow makes the first region's, and moves its bitstream to the others.
    """

    module: ModuleSpec
    region: RegionPlan
    identity: int

    @property
    def name(self) -> str:
        """The module's name, with the region's if it may go to several."""
        return self.module.name if len(self.module.regions) == 1 else f"{self.module.name}_{self.region.name}"

    @property
    def moved(self) -> bool:
        """Whether the open flow makes it of another region's bitstream."""
        return self.module.home(self.region.name) != self.region.name


@dataclass(frozen=True, slots=True)
class System:
    """Everything that is generated; `control` is the window of the control registers."""

    project: Project
    platform: Platform
    device: str
    regions: tuple[RegionPlan, ...]
    domains: tuple[Domain, ...]
    control: Window
    icap: Dma | None
    implementations: tuple[Implementation, ...]
    runs: tuple[Mapping[str, str], ...]  # region → implementation's name; the first is the initial one
    cover: Cover
    notes: tuple[str, ...] = ()
    switch: SwitchPlan | None = None
    readback: Dma | None = None  # what comes back from the configuration port
    static_identity: int = 0  # what the control register STATIC_ID reads; 0: not computed

    @property
    def full(self) -> str:
        """The name of the bitstream of the whole device; a module may have the project's own name."""
        return f"{self.project.name}_full"

    @property
    def dmas(self) -> tuple[Dma, ...]:
        """All DMA channels, the ICAP's first."""
        return (*(dma for dma in (self.icap, self.readback) if dma), *(bus.dma for bus in self.streams if bus.dma))

    @property
    def streams(self) -> tuple[StreamBus, ...]:
        """All streams: those of regions, then those between the switch and memory."""
        own = self.switch.streams if self.switch else ()
        return (*(bus for region in self.regions for bus in region.streams), *own)

    @property
    def engines(self) -> tuple[Engine, ...]:
        """All DMA engines, the ICAP's first."""
        return engines_of(self.dmas)

    @property
    def crowded(self) -> tuple[int, ...]:
        """Interrupt lines that several DMA channels share: the static part ORs their levels."""
        lines = [dma.line for dma in self.dmas]
        return tuple(sorted({line for line in lines if lines.count(line) > 1}))

    @property
    def lines(self) -> tuple[Line, ...]:
        """All lines of the concentrator."""
        return tuple(line for region in self.regions for line in region.lines)

    def region(self, name: str) -> RegionPlan:
        """The region of that name."""
        return next(region for region in self.regions if region.name == name)

    def implementation(self, module: str, region: str) -> Implementation:
        """The implementation of a module in a region."""
        return next(i for i in self.implementations if i.module.name == module and i.region.name == region)

    @property
    def placed(self) -> tuple[Implementation, ...]:
        """The implementations that the open flow places and routes."""
        return tuple(one for one in self.implementations if not one.moved)

    @property
    def moved(self) -> tuple[tuple[Implementation, Implementation], ...]:
        """Those that it moves, each after the one that it is made of."""
        moved = (one for one in self.implementations if one.moved)
        return tuple((self.implementation(one.module.name, one.module.regions[0]), one) for one in moved)


def used_clocks(system: System) -> list[str]:
    """Clocks that are in use, in the order of the build schema."""
    used = {domain.clock for domain in system.domains} | {region.spec.clock for region in system.regions}
    used |= {system.switch.clock} if system.switch else set()
    used |= {clock for region in system.regions for clock in region.clocks.values() if clock}
    return [clock for clock in system.project.clocks if clock in used]
