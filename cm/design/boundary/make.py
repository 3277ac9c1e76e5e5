# SPDX-License-Identifier: Apache-2.0
"""`boundary`: the union of what a region's modules need, with widths reconciled, and how each module is fitted."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from cm.design.boundary.buses import Fitting, bus_interface, bus_ports, fit_bus
from cm.design.boundary.model import Adaptation, Boundary, BoundaryPort
from cm.design.boundary.scalar_signals import (
    Clocks,
    clock_ports,
    fit_clocks,
    fit_single,
    keep_defaults,
    make_clocks,
    make_interrupts,
    make_signals,
    reset_of,
)
from cm.design.boundary.slots import Slot, make_slots
from cm.design.hdl.model import Interface, ModuleInfo, Polarity
from cm.frozen import replace


def boundary(given: Mapping[str, ModuleInfo], named: Collection[str] = ()) -> Boundary:
    """The boundary that all modules of a region share, by their names; their order is that of the result.

    `named`: the interfaces that the build schema mentions; an input with a default crosses the boundary if it is one.

    Modules that cannot be fitted are in the result with the reasons in `refused`; the others are still fitted.
    """
    modules = [replace(module, name=name) for name, module in given.items()]
    slots = make_slots(modules)
    clocks = make_clocks(modules)
    ports = clock_ports(clocks)
    for slot in slots.slots:
        ports.extend(bus_ports(slot, modules))
    interrupts = make_interrupts(modules)
    signals, refused = make_signals(
        modules, [*(port.name for port in ports), *(item.name for item in interrupts)], named
    )
    singles = [*interrupts, *signals]
    ports.extend(single.port() for single in singles)
    fittings = {module.name: Fitting() for module in modules}
    for module in modules:
        fitting = fittings[module.name]
        fitting.refused += [str(problem) for problem in module.problems if problem.fatal]
        fitting.refused += [*refused.get(module.name, ()), *slots.refused[module.name]]
        fitting.notes += slots.notes[module.name]
        fit_clocks(clocks, module, fitting)
        for slot in slots.slots:
            fit_bus(slot, ports, module, fitting)
        for single in singles:
            fit_single(single, module, fitting)
        keep_defaults(module, named, fitting)
    interfaces = tuple(_interface(slot, ports, clocks, fittings) for slot in slots.slots)
    return Boundary(tuple(ports), interfaces, tuple(_adaptation(name, item) for name, item in fittings.items()))


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
    found = bus_interface(slot, ports, clock, reset_of(clock) if clock else None)
    return replace(found, reset_polarity=Polarity.LOW if clock else None)


def _adaptation(module: str, fitting: Fitting) -> Adaptation:
    refused = tuple(dict.fromkeys(fitting.refused))
    return Adaptation(module, tuple(fitting.connections), tuple(dict.fromkeys(fitting.notes)), refused)
