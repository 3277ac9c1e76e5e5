# SPDX-License-Identifier: Apache-2.0
"""The report of `cm build check`: as data for scripts, as lines for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from cm.design.boundary.analyse import Analysis
from cm.design.boundary.model import Adaptation, Boundary, Fit, Role
from cm.design.hdl.model import Mode, ModuleInfo, PortDirection
from cm.design.plan.dma_engines import EngineKind
from cm.design.plan.steps import shelled
from cm.design.plan.system import RegionPlan, StreamBus, System
from cm.design.project.model import Project

_PLAIN = (Fit.CONNECT,)


def as_dict(project: Project, analysis: Analysis, system: System | None) -> dict[str, Any]:
    """The report for ``--json``."""
    found: dict[str, Any] = {
        "project": project.name,
        "modules": {name: _module(info, analysis.differences[name]) for name, info in analysis.modules.items()},
        "regions": {name: _region(found) for name, found in analysis.boundaries.items()},
        "refused": list(analysis.refused),
        "broken": analysis.broken,
    }
    if system is not None:
        found["runs"] = [dict(run) for run in system.runs]
        found["fewest"] = {"runs": len(system.runs), "bound": system.cover.bound, "proved": system.cover.exact}
        found["notes"] = list(system.notes)
        if system.switch is not None:
            found["routes"] = {name: dict(mode.routes) for name, mode in system.project.modes.items()}
    return found


def _module(info: ModuleInfo, differences: tuple[str, ...]) -> dict[str, Any]:
    return {
        "top": info.name,
        "interfaces": [
            {"name": i.name, "protocol": i.protocol, "mode": i.mode.value, "ports": dict(i.ports)}
            for i in info.interfaces
        ],
        "interrupts": [interrupt.port for interrupt in info.interrupts],
        "leftover": {left.port: left.reason for left in info.leftovers},
        "problems": [str(problem) for problem in info.problems],
        "differences": list(differences),
    }


def _region(boundary: Boundary) -> dict[str, Any]:
    return {
        "ports": {port.name: port.width for port in boundary.ports},
        "interfaces": {i.name: {"protocol": i.protocol, "mode": i.mode.value} for i in boundary.interfaces},
        "modules": {
            a.module: {"fits": a.ok, "adapted": [*adapted(a, boundary)], "notes": a.notes, "refused": a.refused}
            for a in boundary.adaptations
        },
    }


def adapted(adaptation: Adaptation, boundary: Boundary) -> Iterator[str]:
    """What the wrapper does beyond plain connections, one phrase per port or whole interface."""
    present = {connection.boundary for connection in adaptation.connections if connection.module}
    absent = [i for i in boundary.interfaces if not present.intersection(i.ports.values())]
    for interface in absent:
        answered = interface.protocol in ("axi4", "axi4lite") and interface.mode is Mode.SLAVE
        yield f"{interface.name}: {'answered with SLVERR' if answered else 'idle'}"
    skipped = {port for interface in absent for port in interface.ports.values()}
    for connection in adaptation.connections:
        if connection.fit in _PLAIN or connection.boundary in skipped:
            continue
        name = connection.module or connection.boundary
        if connection.fit in (Fit.EXTEND, Fit.TRUNCATE):
            yield f"{name}: {connection.module_width} to {connection.boundary_width} bits"
        elif connection.fit is Fit.INVERT:
            yield f"{name}: inverted"
        elif connection.fit is Fit.TIE:
            yield f"{name}: tied to {connection.value}"
        elif connection.direction is PortDirection.IN and not connection.boundary:
            yield f"{name}: keeps its default"
        else:
            yield f"{name}: open"


def lines(project: Project, analysis: Analysis, system: System | None) -> Iterator[str]:
    """The report for people."""
    for name, info in analysis.modules.items():
        yield f"module {name} ({info.name}, {info.language.value})"
        for interface in info.interfaces:
            width = f", {interface.data_width} bits" if interface.data_width else ""
            yield f"  {interface.name}: {interface.protocol} {interface.mode.value}{width}"
        for interrupt in info.interrupts:
            yield f"  {interrupt.port}: interrupt"
        for left in info.leftovers:
            yield f"  {left.port}: left over, {left.reason}"
        for problem in info.problems:
            yield f"  problem: {problem}"
        for difference in analysis.differences[name]:
            yield f"  differs from {project.modules[name].component}: {difference}"
    for region, boundary in analysis.boundaries.items():
        yield from _region_lines(region, boundary, analysis, system)
    if system is not None:
        yield from _switch_lines(system)
        yield f"{system.cover}"
        for number, run in enumerate(system.runs, 1):
            yield f"  run_{number}: " + ", ".join(f"{region}: {module}" for region, module in run.items())
        for one in shelled(system):
            yield f"  {one.module.name}: in the abstract shell of {one.region.name}"
        for note in system.notes:
            yield f"note: {note}"
    if analysis.broken:
        problems = "problem" if analysis.broken == 1 else "problems"
        yield f"{analysis.broken} {problems} that synthesis will stop at, see above"


def _region_lines(region: str, boundary: Boundary, analysis: Analysis, system: System | None) -> Iterator[str]:
    bits = sum(port.width for port in boundary.ports)
    yield f"region {region}: {len(boundary.ports)} ports, {bits} bits"
    goes = dict(_connected(system.region(region))) if system is not None else {}
    for interface in boundary.interfaces:
        yield f"  {interface.name}: {interface.protocol} {interface.mode.value}{goes.pop(interface.name, '')}"
    for name, where in goes.items():
        yield f"  {name}{where}"
    if system is not None:
        yield from _clock_lines(system.region(region), system)
    for adaptation in boundary.adaptations:
        phrases = list(adapted(adaptation, boundary))
        how = "refused" if not adaptation.ok else "adapted: " + "; ".join(phrases) if phrases else "fits as it is"
        yield f"  {adaptation.module}: {how}"
        for sentence in adaptation.refused:
            yield f"    {analysis.placed(adaptation.module, sentence)}"
        for note in adaptation.notes:
            yield f"    {note}"


def _switch_lines(system: System) -> Iterator[str]:
    """The stream switch, and the routes of each mode."""
    switch = system.switch
    if switch is None:
        return
    ends = f"{len(switch.sources)} sources, {len(switch.sinks)} sinks, {switch.width} bits"
    yield f"switch: {ends}, registers at {switch.window.base:#x}, on {switch.clock}"
    for mode in system.project.modes.values():
        routes = ", ".join(f"{source} → {sink}" for sink, source in mode.routes.items())
        yield f"  {mode.name}: {routes or 'no route'}"


def _clock_lines(region: RegionPlan, system: System) -> Iterator[str]:
    for port, clock in region.clocks.items():
        known = system.project.clocks.get(clock or "")
        rate = known.rate if known else 0
        yield f"  {port}: clock → {clock or 'nothing says what drives it'}{f', {rate / 1e6:g} MHz' if rate else ''}"
    for boundary_port in region.boundary.ports:
        if boundary_port.role is Role.RESET:
            yield f"  {boundary_port.name}: reset, active low → the region's, on its clock"


def _connected(region: RegionPlan) -> Iterator[tuple[str, str]]:
    """Yield each interface or single port with what it is connected to, in words."""
    for registers in region.registers:
        yield registers.interface.name, f" → {registers.window.size:#x} bytes at {registers.window.base:#x}"
    for stream in region.streams:
        yield stream.interface.name, _stream(stream)
    for interface in region.memory:
        yield interface.name, " → memory"
    for line in region.lines:
        yield line.port, " → interrupt concentrator"
    for ports, where in ((region.external, _TOP), (region.unused, " → nothing")):
        for port in ports:
            yield port.interface or port.name, where


_TOP = " → ports of the top"


def _stream(bus: StreamBus) -> str:
    width = f", {8 * bus.bytes} to {bus.width} bits" if bus.converted else ""
    if bus.switched:
        return f" → switch{width}"
    if bus.dma is None:
        return _TOP
    dma = bus.dma
    kind = {EngineKind.DMA: "DMA", EngineKind.MCDMA: "MCDMA", EngineKind.VDMA: "VDMA"}[dma.kind]
    engine = f" {dma.engine}" if dma.engine != bus.name else ""
    return f" → {kind}{engine}, stream {bus.name} ({dma.direction.value}){width}"
