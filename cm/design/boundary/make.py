# SPDX-License-Identifier: Apache-2.0
"""`boundary`: the union of what a region's modules need, with widths reconciled, and how each module is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType

from cm.design.boundary.buses import Fitting, bus_interface, bus_ports, fit_bus
from cm.design.boundary.model import Adaptation, Boundary, BoundaryPort
from cm.design.boundary.scalar_signals import (
    Clocks,
    Single,
    clock_ports,
    fit_clocks,
    fit_single,
    make_clocks,
    make_interrupts,
    make_signals,
)
from cm.design.boundary.slots import Names, Slot, make_slots
from cm.design.hdl.model import Interface, ModuleInfo, Polarity

_NO_NAMES: Names = MappingProxyType({})


def boundary(modules: Sequence[ModuleInfo], names: Names = _NO_NAMES, labels: Sequence[str] | None = None) -> Boundary:
    """The boundary that all `modules` of a region share; the order of modules is that of the result.

    `names` gives for (module, interface) the interface of the boundary, where names and kinds do not decide. Modules
    that cannot be fitted are in the result with the reasons in `refused`; the others are still fitted. `labels` name
    the modules in the result and in `names`, one each, instead of their own names: needed where two have the same top
    with different parameters or sources. Without labels, modules that differ but share a name are refused.
    """
    if labels is not None:
        modules = [replace(module, name=label) for module, label in zip(modules, labels, strict=True)]
    modules, clashes = _distinct(modules)
    slots = make_slots(modules, names)
    clocks = make_clocks(modules)
    ports = clock_ports(clocks)
    for slot in slots.slots:
        ports.extend(bus_ports(slot, modules))
    interrupts = make_interrupts(modules)
    signals, refused = make_signals(modules, [*(port.name for port in ports), *(item.name for item in interrupts)])
    singles = [*interrupts, *signals]
    ports.extend(single.port() for single in singles)
    fittings = {module.name: Fitting() for module in modules}
    for module in modules:
        fitting = fittings[module.name]
        fitting.refused.extend(clashes.get(module.name, ()))
        fitting.refused.extend(str(problem) for problem in module.problems if problem.fatal)
        fitting.refused.extend(refused.get(module.name, ()))
        fitting.refused.extend(slots.refused.get(module.name, ()))
        fitting.notes.extend(slots.notes.get(module.name, ()))
        _fit(module, fitting, clocks, slots.slots, ports, singles)
    interfaces = tuple(_interface(slot, ports, clocks, fittings) for slot in slots.slots)
    return Boundary(tuple(ports), interfaces, tuple(_adaptation(name, item) for name, item in fittings.items()))


def _distinct(modules: Sequence[ModuleInfo]) -> tuple[list[ModuleInfo], dict[str, list[str]]]:
    """Return the first module of each name, and a reason where a later one of that name has other ports."""
    found: dict[str, ModuleInfo] = {}
    clashes: dict[str, list[str]] = {}
    for module in modules:
        first = found.setdefault(module.name, module)
        if _shape(first) != _shape(module):
            text = f"two modules of the region are called {module.name} and differ ({first.file}, {module.file})"
            clashes.setdefault(module.name, []).append(f"{text}: rename one")
    return list(found.values()), clashes


def _shape(module: ModuleInfo) -> list[tuple[object, ...]]:
    return [(port.name, port.direction, port.width) for port in module.ports]


def _fit(
    module: ModuleInfo,
    fitting: Fitting,
    clocks: Clocks,
    slots: Sequence[Slot],
    ports: Sequence[BoundaryPort],
    singles: Sequence[Single],
) -> None:
    fit_clocks(clocks, module, fitting)
    for slot in slots:
        fit_bus(slot, ports, module, fitting)
    for single in singles:
        fit_single(single, module, fitting)


def _interface(slot: Slot, ports: Sequence[BoundaryPort], clocks: Clocks, fittings: dict[str, Fitting]) -> Interface:
    """Give the slot the first module's clock; a module that runs it on another clock is refused."""
    clock: str | None = None
    owner = ""
    for module, interface in slot.members.items():
        mine = clocks.of.get((module, interface.clock or ""))
        if mine is None and len(clocks.names) == 1:
            mine = clocks.names[0]
        if mine is None:
            if interface.protocol.startswith("axi"):
                port = next((port for owner, port in clocks.of if owner == module), "CLOCK")
                line = f"clocks: {{{port}: {{interfaces: [{interface.name}]}}}}"
                text = f"write {line} under the module, with the right one"
                fittings[module].refused.append(f"the clock of {interface.name} is not known: {text}")
        elif clock is None:
            clock, owner = mine, module
        elif mine != clock:
            text = f"{interface.name} runs on {mine}, but the {slot.name} of {owner} on {clock}: it needs a crossing"
            fittings[module].refused.append(text)
    found = bus_interface(slot, ports, clock, clocks.reset(clock) if clock else None)
    return replace(found, reset_polarity=Polarity.LOW if clock else None)


def _adaptation(module: str, fitting: Fitting) -> Adaptation:
    refused = tuple(dict.fromkeys(fitting.refused))
    return Adaptation(module, tuple(fitting.connections), tuple(dict.fromkeys(fitting.notes)), refused)
