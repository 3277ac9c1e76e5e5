# SPDX-License-Identifier: Apache-2.0
"""Clocks, resets, interrupts and single signals at the boundary.

Each clock of the boundary has one reset, active low; every reset of a module that belongs to the clock is connected
to it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from cm.design.boundary.buses import IN, OUT, Fitting
from cm.design.boundary.model import BoundaryPort, Connection, Fit, Role
from cm.design.boundary.slots import identifier
from cm.design.hdl.associate import undecided
from cm.design.hdl.clock_reset_names import REGION_CLOCK
from cm.design.hdl.model import Mode, ModuleInfo, Polarity, Port, PortDirection, Reset, unique
from cm.frozen import dataclass, field


@dataclass(slots=True)
class Clocks:
    """The boundary's clocks: `of` maps (module, port of the module) to the boundary's clock."""

    names: list[str] = field(default_factory=list)
    of: dict[tuple[str, str], str] = field(default_factory=dict)


def reset_of(clock: str) -> str:
    """The reset that belongs to a clock of the boundary."""
    return "aresetn" if clock == REGION_CLOCK else f"{clock}_resetn"


def make_clocks(modules: Sequence[ModuleInfo]) -> Clocks:
    """One clock `aclk` if no module has more than one; otherwise by name."""
    inputs = {m.name: [c.port for c in m.clocks if c.direction is IN] for m in modules}
    result = Clocks()
    if all(len(ports) <= 1 for ports in inputs.values()):
        result.names = [REGION_CLOCK] if any(inputs.values()) else []
        result.of = {(name, port): REGION_CLOCK for name, ports in inputs.items() for port in ports}
        return result
    for name, ports in sorted(inputs.items(), key=lambda item: -len(item[1])):
        for port in ports:
            result.of[name, port] = _clock(port, name, result)
    return result


def _clock(port: str, module: str, result: Clocks) -> str:
    taken = [clock for (owner, _), clock in result.of.items() if owner == module]
    name = identifier(port)
    if name in result.names and name not in taken:
        return name
    name = unique(name, result.names)
    result.names.append(name)
    return name


def clock_ports(clocks: Clocks) -> list[BoundaryPort]:
    """Ports of all clocks and their resets."""
    ports = [BoundaryPort(name, IN, 1, Role.CLOCK) for name in clocks.names]
    return ports + [BoundaryPort(reset_of(name), IN, 1, Role.RESET, idle=1) for name in clocks.names]


def fit_clocks(clocks: Clocks, module: ModuleInfo, fitting: Fitting) -> None:
    """Connect a module's clocks and resets; those that it does not have stay open."""
    used: set[str] = set()
    for clock in module.clocks:
        if clock.direction is not IN:
            text = f"{clock.port} is a clock that the module drives: clocks do not cross a region's boundary outwards"
            fitting.refused.append(text)
            continue
        name = clocks.of[module.name, clock.port]
        used.add(name)
        fitting.connections.append(Connection(name, clock.port, IN, Fit.CONNECT, 1, 1))
    for reset in module.resets:
        used.add(_fit_reset(reset, clocks, module, fitting))
    for port in clock_ports(clocks):
        if port.name not in used:
            fitting.connections.append(Connection(port.name, "", IN, Fit.OPEN, 1))


def _fit_reset(reset: Reset, clocks: Clocks, module: ModuleInfo, fitting: Fitting) -> str:
    if reset.direction is not IN:
        fitting.refused.append(f"{reset.port} is a reset that the module drives: name it as a signal")
        return ""
    if reset.polarity is None:
        fitting.refused.append(
            f"the polarity of the reset {reset.port} is not known: state it with X_INTERFACE_PARAMETER, or write "
            f"resets: {{{reset.port}: {{polarity: low}}}} (or high) under the module"
        )
        return ""
    if not clocks.names:
        fitting.refused.append(f"the reset {reset.port} belongs to no clock: the region has none")
        return ""
    if reset.may_be:
        fitting.refused.append(undecided(reset))
        return ""
    name = reset_of(clocks.of.get((module.name, reset.clock or ""), clocks.names[0]))
    fit = Fit.INVERT if reset.polarity is Polarity.HIGH else Fit.CONNECT
    fitting.connections.append(Connection(name, reset.port, IN, fit, 1, 1))
    return name


@dataclass(slots=True)
class Single:
    """One interrupt or signal of the boundary: the modules' ports by module."""

    name: str
    direction: PortDirection
    role: Role
    members: dict[str, Port] = field(default_factory=dict)
    left: str = ""

    @property
    def width(self) -> int:
        """Bits of the widest member."""
        return max(port.width or 1 for port in self.members.values())

    def port(self) -> BoundaryPort:
        """As a port of the boundary."""
        return BoundaryPort(self.name, self.direction, self.width, self.role, left=self.left)


def make_interrupts(modules: Sequence[ModuleInfo]) -> list[Single]:
    """Interrupts by name; if no module has more than one in a direction, it is called `interrupt`."""
    found: dict[str, Single] = {}
    for mode, only, direction in ((Mode.MASTER, "interrupt", OUT), (Mode.SLAVE, "interrupt_in", IN)):
        ports = [(m, [m.port(i.port) for i in m.interrupts if i.mode is mode]) for m in modules]
        single = all(len(mine) <= 1 for _, mine in ports)
        for module, mine in ports:
            for port in mine:
                name = only if single else identifier(port.name)
                one = found.setdefault(name, Single(name, direction, Role.INTERRUPT))
                one.members[module.name] = port
    return list(found.values())


def has_default(port: Port, named: Collection[str]) -> bool:
    """Whether an input keeps the default that the HDL gives it: the build schema does not name it for the region."""
    return port.direction is IN and bool(port.default) and identifier(port.name) not in named


def make_signals(
    modules: Sequence[ModuleInfo], taken: Sequence[str], named: Collection[str]
) -> tuple[list[Single], dict[str, list[str]]]:
    """Ports left over, shared by name; those that cannot cross the boundary, with the reason, by module.

    Inputs with a default do not cross it, unless they are among the `named`.
    """
    found: dict[str, Single] = {}
    refused: dict[str, list[str]] = {}
    for module in modules:
        for left in module.leftovers:
            port = module.port(left.port)
            if port.width != 0 and (reason := _unfit(port, left.reason)):
                refused.setdefault(module.name, []).append(f"port {port.name} {reason}")
                continue
            if has_default(port, named) or port.width == 0:  # a null range of VHDL has no bits
                continue
            name = identifier(port.name)
            name = f"{name}_signal" if name in taken else name
            single = found.setdefault(name, Single(name, port.direction, Role.SIGNAL, left=left.reason))
            single.members[module.name] = port
    return list(found.values()), refused


def keep_defaults(module: ModuleInfo, named: Collection[str], fitting: Fitting) -> None:
    """Leave the inputs with a default of their own unconnected."""
    for port in (module.port(left.port) for left in module.leftovers):
        if port.flat and has_default(port, named):
            fitting.connections.append(Connection("", port.name, IN, Fit.OPEN, 0, port.width or 0))


def _unfit(port: Port, reason: str) -> str:
    if not port.flat:
        return f"{reason}: needs a flat wrapper"
    if port.direction not in (IN, OUT):
        return "is bidirectional: use separate input, output and enable, and put the buffer into the static part"
    if not port.width:
        return "has a width that could not be evaluated"
    if reason.startswith("looks like"):
        return reason
    return ""


def fit_single(single: Single, module: ModuleInfo, fitting: Fitting) -> None:
    """Connect one module's interrupt or signal, or tie it."""
    port, want = module.port(single.members[module.name].name) if module.name in single.members else None, single.width
    if port is None:
        fit = Fit.TIE if single.direction is OUT else Fit.OPEN
        fitting.connections.append(Connection(single.name, "", single.direction, fit, want))
        return
    have = port.width or 0
    if port.direction is not single.direction:
        text = f"port {port.name} is {port.direction.value}, another module's {single.name} is {single.direction.value}"
        fitting.refused.append(text)
    elif have == want:
        fitting.connections.append(Connection(single.name, port.name, port.direction, Fit.CONNECT, want, have))
    elif port.direction is OUT and have:
        fitting.notes.append(f"{port.name}: {have} of {want} bits are driven, the rest is 0")
        fitting.connections.append(Connection(single.name, port.name, OUT, Fit.EXTEND, want, have))
    else:
        text = f"port {port.name} has {have} bits, another module's {single.name} {want}: give them different names"
        fitting.refused.append(text)
