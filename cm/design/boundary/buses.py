# SPDX-License-Identifier: Apache-2.0
"""Slots to boundary ports, and each module's connections there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from types import MappingProxyType

from cm.design.boundary.model import BoundaryPort, Connection, Fit, Role
from cm.design.boundary.rules import Missing, Policy, lacks_input, lacks_output, policy
from cm.design.boundary.slots import Slot
from cm.design.hdl.axi_signals import aximm, axis
from cm.design.hdl.model import Interface, Mode, ModuleInfo, PortDirection
from cm.frozen import dataclass, field

IN, OUT = PortDirection.IN, PortDirection.OUT
_FAILURES = "its data would be cut or padded: give both the same width, or put a width converter inside the module"


@dataclass(slots=True)
class Fitting:
    """The connections, notes and refusals gathered for one module."""

    connections: list[Connection] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


def signals_of(slot: Slot) -> list[str]:
    """All logical signals of a slot's members, in the protocol's order."""
    known = [*axis().signals, *aximm().signals]
    found = dict.fromkeys(signal for interface in slot.members.values() for signal in interface.ports)
    return sorted(found, key=lambda signal: known.index(signal) if signal in known else len(known))


def bus_ports(slot: Slot, modules: Sequence[ModuleInfo]) -> list[BoundaryPort]:
    """The boundary's ports for a slot, widths reconciled; signals without a safe width are left out."""
    ports = []
    for signal in signals_of(slot):
        widths = [interface.widths.get(signal) for interface in slot.members.values()]
        width = _width(policy(slot.protocol, slot.mode, signal), widths)
        if width:
            direction = _direction(slot, signal, modules)
            idle = 1 if signal == "TREADY" else 0
            name = f"{slot.name}_{signal.lower()}"
            ports.append(BoundaryPort(name, direction, width, Role.BUS, slot.name, signal, idle))
    return ports


def _width(how: Policy, widths: Sequence[int | None]) -> int:
    """Bits of a boundary port, or 0 for no port. A module without the signal counts if all must see it whole."""
    known = [width for width in widths if width]
    if not known:
        return 0
    if how is Policy.WIDEST:
        return max(known)
    if how is Policy.NARROWEST:
        return min(width or 0 for width in widths)
    counts = Counter(known)
    return max(counts, key=lambda width: (counts[width], width))


def _direction(slot: Slot, signal: str, modules: Sequence[ModuleInfo]) -> PortDirection:
    for module in modules:
        interface = slot.members.get(module.name)
        if interface is not None and signal in interface.ports:
            return module.port(interface.ports[signal]).direction
    raise KeyError(signal)


def bus_interface(slot: Slot, ports: Sequence[BoundaryPort], clock: str | None, reset: str | None) -> Interface:
    """The slot as an interface of the boundary."""
    first = next(iter(slot.members.values()))
    mine = [port for port in ports if port.interface == slot.name]
    return Interface(
        name=slot.name,
        protocol=slot.protocol,
        mode=slot.mode,
        ports=MappingProxyType({port.logical: port.name for port in mine}),
        clock=clock,
        reset=reset,
        widths=MappingProxyType({port.logical: port.width for port in mine}),
        found_by=first.found_by,
        vlnv=first.vlnv,
    )


def fit_bus(slot: Slot, ports: Sequence[BoundaryPort], module: ModuleInfo, fitting: Fitting) -> None:
    """Connect one module at one slot, or record why that is impossible."""
    interface = slot.members.get(module.name)
    mine = {port.logical: port for port in ports if port.interface == slot.name}
    if interface is None:
        fitting.connections.extend(_loose(port, port.idle) for port in mine.values())
        fitting.notes.extend(_absent_note(slot))
        return
    for signal, port in mine.items():
        if signal in interface.ports and interface.widths.get(signal) != 0:
            _meet(slot, interface, signal, port, fitting)
        else:
            _lack(slot, interface, signal, port, fitting)
    for signal, name in interface.ports.items():
        if signal not in mine:
            _surplus(module, interface, signal, name, fitting)


def _loose(port: BoundaryPort, value: int, note: str = "") -> Connection:
    """A port of the boundary that the module does not have: tied where the module would drive it."""
    fit = Fit.TIE if port.direction is OUT else Fit.OPEN
    return Connection(port.name, "", port.direction, fit, port.width, value=value, note=note)


def _absent_note(slot: Slot) -> list[str]:
    if slot.mode is Mode.SLAVE and slot.protocol == "axis":
        return [f"has no {slot.name}: data sent there is dropped, so that the sender does not hang"]
    if slot.mode is Mode.SLAVE and slot.protocol.startswith("axi"):
        return [f"has no {slot.name}: the generated wrapper answers accesses with an error, so that none hangs the bus"]
    return [f"has no {slot.name}: it stays idle"]


def _meet(slot: Slot, interface: Interface, signal: str, port: BoundaryPort, fitting: Fitting) -> None:
    have, want = interface.widths.get(signal), port.width
    where = f"{interface.name}.{signal}"
    if have is None:
        fitting.refused.append(f"the width of {where} could not be evaluated")
        return
    fit, note = Fit.CONNECT, ""
    if have != want:
        if policy(slot.protocol, slot.mode, signal) is Policy.SAME:
            fitting.refused.append(f"{where} has {have} bits, the region's {slot.name} {want}: {_FAILURES}")
            return
        narrower = have < want
        fit = Fit.EXTEND if (port.direction is OUT) == narrower else Fit.TRUNCATE
        if fit is Fit.TRUNCATE and port.direction is IN:
            note = f"{where}: {have} of {want} bits are read, the rest is dropped"
        elif fit is Fit.EXTEND and port.direction is OUT:
            note = f"{where}: {have} of {want} bits are driven, the rest is 0"
        # else an ID: padded with zeros on one side, which are dropped again on the other
        fitting.notes += [note] if note else []
    fitting.connections.append(
        Connection(port.name, interface.ports[signal], port.direction, fit, want, have, note=note)
    )


def _lack(slot: Slot, interface: Interface, signal: str, port: BoundaryPort, fitting: Fitting) -> None:
    rule = lacks_output if port.direction is OUT else lacks_input
    missing: Missing = rule(slot.protocol, slot.mode, signal, interface.ports)
    if missing.refusal:
        fitting.refused.append(f"{interface.name} {missing.refusal}")
        return
    if missing.note:
        fitting.notes.append(f"{interface.name} {missing.note}")
    fitting.connections.append(_loose(port, missing.value or 0, missing.note))


def _surplus(module: ModuleInfo, interface: Interface, signal: str, name: str, fitting: Fitting) -> None:
    """Handle a signal that the boundary leaves out: an ID that another module does not have."""
    port = module.port(name)
    if port.width is None:
        fitting.refused.append(f"the width of {interface.name}.{signal} could not be evaluated")
    if not port.width:  # a null range of VHDL has no bits
        return
    tied = port.direction is IN and not port.default
    fitting.connections.append(Connection("", name, port.direction, Fit.TIE if tied else Fit.OPEN, 0, port.width))
    if tied:
        fitting.notes.append(f"{interface.name}.{signal} is 0: another module of the region has none")
