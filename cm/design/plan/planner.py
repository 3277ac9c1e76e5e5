# SPDX-License-Identifier: Apache-2.0
"""Project and boundaries → `cm.design.plan.system.System`: connections, addresses, interrupt lines, runs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping

from cm.design.boundary.model import Boundary
from cm.design.errors import BuildError
from cm.design.hdl.model import Interface
from cm.design.parts import device_of
from cm.design.plan.addresses import CONTROL_SIZE, Allocator, Window
from cm.design.plan.connections import RegionPlanner
from cm.design.plan.dma_engines import Dma
from cm.design.plan.minimal_runs import Cover, check_shells, cover, first_run
from cm.design.plan.stream_frames import check_frames
from cm.design.plan.streams import READBACK, crowding, place
from cm.design.plan.switch import own_streams, plan_switch, switch_width
from cm.design.plan.system import (
    Domain,
    Implementation,
    RegionPlan,
    StreamBus,
    SwitchPlan,
    System,
)
from cm.design.platforms import Platform, platform_of
from cm.design.project.model import ConnectionSpec, Project
from cm.design.project.source_position import fault
from cm.frozen import replace
from cm.schema.model import Direction, LoaderKind

MAX_INTERRUPTS = 128  # of all modules together: cm_control.v


def plan_system(project: Project, boundaries: Mapping[str, Boundary]) -> System:
    """Plan the system around `project`'s regions. Raises BuildError if something cannot be connected."""
    return _Planner(project).plan(boundaries)


class _Planner:
    def __init__(self, project: Project) -> None:
        self._project = project
        taken = project.kit.taken_interrupts if project.kit else ()
        self._platform: Platform = replace(platform_of(project.part), taken=taken)
        self._addresses = Allocator(self._platform.base, self._platform.size, tuple(project.clocks))
        self._notes: list[str] = []

    def plan(self, boundaries: Mapping[str, Boundary]) -> System:
        project = self._project
        main = next(iter(project.clocks))
        self._check_coherence()
        check_shells(project, self._platform)
        control = self._addresses.control(main)
        port = self._port(main)
        width = switch_width(project, _switched(project, boundaries))
        planner = RegionPlanner(project, self._addresses, width)
        regions = tuple(
            planner.plan(index, region, boundaries[region.name])
            for index, region in enumerate(project.regions.values())
        )
        self._notes += planner.notes
        if planner.bits > MAX_INTERRUPTS:
            message = f"the modules have {planner.bits} interrupts, the concentrator holds {MAX_INTERRUPTS}"
            raise BuildError(f"{message}: connect some to external or none")
        own = own_streams(project, width) if project.switch else ()
        regions, own, port = place(project, regions, own, port, self._addresses, self._platform.irq_count)
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
            icap=port[0] if port else None,
            implementations=tuple(self._implementations(regions)),
            runs=tuple(self._names(run) for run in covered.runs),
            cover=covered,
            notes=tuple(self._notes),
            switch=switch,
            readback=port[1] if len(port) > 1 else None,
        )

    def _switch(self, regions: tuple[RegionPlan, ...], own: tuple[StreamBus, ...]) -> SwitchPlan | None:
        if self._project.switch is None:
            return None
        window = self._addresses.registers("switch", CONTROL_SIZE, self._project.switch.clock)
        return plan_switch(self._project, regions, window, own)

    def _check_coherence(self) -> None:
        """Check coherence: only UltraScale+ has coherent ports as wide as those that the block design uses."""
        if self._project.static.coherent and not self._platform.coherent_slaves:
            message = f"{self._platform.name} has no coherent port that the generated block design uses"
            hint = "leave it out: the DMA goes through HP ports then, and the runtime syncs each frame"
            raise fault(self._project.source, ("static", "coherent"), message, hint)
        if self._project.static.coherent:
            self._notes.append(
                "HPC ports snoop only with broadcasting on: the boot loader has to write 3 to LPD_SLCR.lpd_apu "
                "(0xff41a040) before the processors start, which an [init] file of bootgen can do (UG1085)"
            )

    def _port(self, clock: str) -> tuple[Dma, ...]:
        """Return the channels of the configuration port: none, that to it, or that and the one back."""
        back = self._project.static.readback
        if not any(region.loader in (LoaderKind.ICAP, LoaderKind.AUTO) for region in self._project.regions.values()):
            if back:
                message = "no region is loaded through the ICAP, so there is nothing that could be read back"
                raise fault(self._project.source, ("static", "readback"), message, "give a region loader: icap")
            return ()
        rate, limit = self._project.clocks[clock].rate, self._platform.icap_rate_max
        if rate > limit:
            message = f"the ICAP runs on {clock} at {rate} Hz; {self._platform.name} allows {limit} Hz"
            hint = "list a slower clock first, or give regions another loader"
            raise fault(self._project.source, ("clocks", clock, "rate"), message, hint)
        sends = Dma("icap", Direction.MM2S, Window("", 0, 0), -1, clock, 32)
        return (sends, replace(sends, name=READBACK, direction=Direction.S2MM, engine="icap")) if back else (sends,)

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
                home = module.home(region.name)  # what is moved answers as where it comes from
                yield Implementation(module, region, identity_of(self._project.name, home, module.name))

    def _names(self, run: Mapping[str, str]) -> dict[str, str]:
        """Region → name of the implementation."""
        return {
            region: module if len(self._project.modules[module].regions) == 1 else f"{module}_{region}"
            for region, module in run.items()
        }


def _switched(project: Project, boundaries: Mapping[str, Boundary]) -> Iterator[Interface]:
    """Interfaces of regions that go to the switch."""
    for region in project.regions.values():
        for interface in boundaries[region.name].interfaces:
            if region.interfaces.get(interface.name, ConnectionSpec()).connect == "switch":
                yield interface


def identity_of(project: str, region: str, module: str) -> int:
    """What a module answers in the region's identity register: 31 bits of a hash of its name, never 0."""
    digest = hashlib.sha256(f"{project}/{region}/{module}".encode()).digest()
    return (int.from_bytes(digest[:4], "big") & 0x7FFF_FFFF) | 1
