# SPDX-License-Identifier: Apache-2.0
"""Finds the clock and the reset of an interface, and the clock of a reset: as declared, or by name, or the only one.

Nothing is paired because it is left over: a reset on the wrong clock passes every simulation and fails on the board.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import MappingProxyType

from cm.design.hdl.clock_reset_names import clock_domains, reset_domains, words
from cm.design.hdl.model import FoundBy, Interface, ModuleClock, ModuleInfo, PortDirection, Problem, Reset, Stated
from cm.frozen import dataclass, replace

_BARE = frozenset(["", "ap", "axi", "axis", "sys"])  # the domains of aclk, ap_clk, axi_aclk
_AXI_WORDS = frozenset(["axi", "axis", "axil", "s", "m", "lite", "stream"])
_SIDES = frozenset(["s", "m", "i", "o", "in", "out", "slave", "master"])
_LAST_N = re.compile(r"n(?=_|$)")
_PROTOCOL_WORDS = frozenset(
    ["axi", "axis", "axil", "lite", "full", "stream", "bus", "data", "apb", "ahb", "wb", "avalon", "avl"]
)


@dataclass(frozen=True, slots=True)
class Associated:
    """Interfaces with their clocks and vice versa, resets with their clocks, and what could not be determined."""

    interfaces: tuple[Interface, ...]
    clocks: tuple[ModuleClock, ...]
    resets: tuple[Reset, ...]
    problems: tuple[Problem, ...]


def associate(
    interfaces: Iterable[Interface],
    clocks: Sequence[ModuleClock],
    resets: Sequence[Reset],
    file: str,
    runs: Mapping[str, Sequence[str]] = MappingProxyType({}),
    *,
    sure: bool = True,
    loose: Collection[str] = (),
) -> Associated:
    """Fill in clocks and resets of the interfaces, and vice versa, and the clocks of resets with the reasons.

    `runs`: by port, the clocks at whose edges the sources use it. `sure` is False if the module drives clocks too: then
    being the only clock input proves nothing. `loose`: what resets at once, whatever the clock, or is only used
    at the clock's edges (a synchroniser's input), and may belong to another clock that has its name.
    """
    found = [replace(interface, clock=_clock(interface, clocks, runs, sure)) for interface in interfaces]
    paired = tuple(pair(reset, resets, clocks, found, runs, loose) for reset in resets)
    done, problems = [], []
    completed = [_completed(clock, found, paired) for clock in clocks]
    for interface in found:
        reset = interface.reset or _reset(interface, paired)
        polarity = next((item.polarity for item in paired if item.port == reset), None)
        done.append(replace(interface, reset=reset, reset_polarity=polarity))
        if interface.clock is None and interface.protocol.startswith("axi"):
            problems.append(Problem(_no_clock(interface, completed), file))
    problems += [Problem(undecided(reset), file) for reset in paired if reset.may_be]
    return Associated(tuple(done), tuple(_completed(clock, done, paired) for clock in clocks), paired, tuple(problems))


def pair(
    reset: Reset,
    resets: Sequence[Reset],
    clocks: Sequence[ModuleClock],
    interfaces: Sequence[Interface],
    runs: Mapping[str, Sequence[str]] = MappingProxyType({}),
    loose: Collection[str] = (),
) -> Reset:
    """Return a reset with its clock and the reason, or with the clocks that it may belong to.

    A declared association decides; then the clock of the registers that it resets; then equal names without what says
    clock or reset; then a bus of the reset's name; then words in common; then being the only clock.
    """
    inputs = [clock.port for clock in clocks if clock.direction is PortDirection.IN]
    inputs = [port for port in inputs if not _inverted(port, inputs)]
    if reset.clock is not None or not inputs or reset.direction is not PortDirection.IN:
        return reset
    stated = [clock.port for clock in clocks if reset.port.lower() in (name.lower() for name in clock.resets)]
    stated += [interface.clock for interface in interfaces if interface.reset == reset.port and interface.clock]
    if stated:
        return replace(reset, clock=stated[0], why="stated")
    domains = clock_domains(tuple(inputs))
    own = reset_domains(tuple(item.port for item in resets), tuple(inputs))[reset.port]
    name = " ".join(own)
    used = _among(runs.get(reset.port, ()), inputs)
    if len(used) == 1 and not (own and reset.port in loose and list(domains.values()).count(own) == 1):
        return replace(reset, clock=used[0], why="it resets registers of that clock")
    rules: tuple[tuple[Callable[[str], bool], str], ...] = (
        (lambda port: domains[port] == own, f"both are named {name}" if own else "neither has a name of its own"),
        (lambda port: bool(_own(own)) and {*own} < {*domains[port]}, "words of the names"),
        (lambda port: _bare(own) and _bare(domains[port]), "neither has a name of its own"),
        (lambda port: port in {i.clock for i in interfaces if _same(i.name, own)}, f"the clock of the bus {name}"),
        (
            lambda port: bool(_own(own)) and _own(own) == _own(domains[port]),
            f"both are {name}, but for the protocol",
        ),
        (lambda port: bool(_shared(own, domains[port])), "words of the names"),
    )
    for fits, why in rules:
        fitting = [port for port in inputs if fits(port)]
        if len(fitting) == 1:
            return replace(reset, clock=fitting[0], why=why)
        if fitting:
            break
    if len(inputs) == 1:
        return replace(reset, clock=inputs[0], why="the only clock")
    return replace(reset, may_be=tuple(inputs))


def _inverted(name: str, names: Iterable[str]) -> bool:
    """Whether it is the second half of a differential pair: `clk_n`, `clk0n_pad` beside the same with a p."""
    low, others = name.lower(), {other.lower() for other in names}
    return any(f"{low[: n.start()]}p{low[n.end() :]}" in others for n in _LAST_N.finditer(low))


def restated(info: ModuleInfo, stated: Stated) -> ModuleInfo:
    """A module that no HDL describes, with what the build schema says of its clocks and resets."""
    resets = []
    for reset in info.resets:
        clock, polarity = stated.resets.get(reset.port, (None, None))
        changed = replace(reset, polarity=polarity or reset.polarity)
        resets.append(replace(changed, clock=clock, why="stated", may_be=()) if clock else changed)
    of = {bus: port for port, buses in stated.clocks.items() for bus in buses}
    interfaces = tuple(replace(bus, clock=of.get(bus.name, bus.clock)) for bus in info.interfaces)
    return replace(info, resets=tuple(resets), interfaces=interfaces)


def undecided(reset: Reset) -> str:
    """What a designer has to decide about a reset, with the line that decides it."""
    line = f"resets: {{{reset.port}: {{clock: {reset.may_be[0]}}}}}"
    text = f"{reset.port} is a reset that may belong to any of the clocks {', '.join(reset.may_be)}"
    return f"{text}: write {line} under the module in build.yaml, with the right one, or ASSOCIATED_RESET in the HDL"


def _bare(domain: tuple[str, ...]) -> bool:
    return "_".join(domain) in _BARE


def _same(interface: str, domain: tuple[str, ...]) -> bool:
    """Whether a reset is named like a bus."""
    return bool(domain) and not _bare(domain) and tuple(words(interface)) == domain


def _own(domain: tuple[str, ...]) -> frozenset[str]:
    """The words that are not those of a protocol."""
    return frozenset(domain) - _PROTOCOL_WORDS


def _shared(one: tuple[str, ...], other: tuple[str, ...]) -> frozenset[str]:
    """The words of the shorter name, if the longer one has all of them; words of protocols do not count."""
    left, right = (frozenset(name) - _PROTOCOL_WORDS - _SIDES for name in (one, other))
    return min(left, right, key=len) if left <= right or right <= left else frozenset()


def _no_clock(interface: Interface, clocks: Sequence[ModuleClock]) -> str:
    clocks = sorted(clocks, key=lambda clock: len(clock.interfaces))  # first those on which nothing else runs
    known = f"the clocks are {', '.join(clock.port for clock in clocks)}" if clocks else "no port is named as a clock"
    hint = f'state it with X_INTERFACE_PARAMETER = "ASSOCIATED_BUSIF {interface.name}" on the clock'
    port = clocks[0].port if clocks else "CLOCK"
    line = f"clocks: {{{port}: {{interfaces: [{interface.name}]}}}}"
    return f"the clock of {interface.name} could not be determined: {known}; {hint}, or {line} under the module"


def _completed(clock: ModuleClock, interfaces: Sequence[Interface], resets: Sequence[Reset]) -> ModuleClock:
    names = tuple(interface.name for interface in interfaces if interface.clock == clock.port)
    mine = [reset.port for reset in resets if reset.clock == clock.port]
    used = [interface.reset for interface in interfaces if interface.reset in mine and interface.clock == clock.port]
    return replace(clock, interfaces=names, reset=clock.reset or next(iter((*used, *mine)), None))


def _among(names: Iterable[str], ports: Sequence[str]) -> list[str]:
    """The ports with these names, in any case of letters, as VHDL compares them."""
    wanted = {name.lower() for name in names}
    return [port for port in ports if port.lower() in wanted]


def named_after(driven: Sequence[str], interfaces: Iterable[Interface], inputs: Sequence[str]) -> list[str]:
    """Clocks that the module drives, and whose names fit an interface better than those of all clocks it is given."""
    ports = [*driven, *inputs]
    domains = {port: "_".join(found) for port, found in clock_domains(tuple(ports)).items()}
    best = [
        best_fit(interface.name, domains) for interface in interfaces if _clocked(interface) and not interface.clock
    ]
    return [port for port in driven if port in best]


def _clock(
    interface: Interface, clocks: Sequence[ModuleClock], runs: Mapping[str, Sequence[str]], sure: bool
) -> str | None:
    if interface.clock:
        return interface.clock
    for clock in clocks:
        if interface.name.lower() in (name.lower() for name in clock.interfaces):
            return clock.port
    if not _clocked(interface):
        return None
    ports = [clock.port for clock in clocks]
    used = _among((name for port in interface.ports.values() for name in runs.get(port, ())), ports)
    if len(used) == 1:
        return used[0]
    domains = {port: "_".join(found) for port, found in clock_domains(tuple(ports)).items()}
    if len(ports) > 1 and not {*_normal(interface.name)} & _AXI_WORDS:  # AMBA's clock is of AMBA's buses
        domains = {port: "a" if "aclk" in port.lower() and not domain else domain for port, domain in domains.items()}
    return _by_name(interface.name, domains, sure=sure)


def _reset(interface: Interface, resets: Sequence[Reset]) -> str | None:
    """The reset of an interface's clock; of several, the one whose name fits the interface best."""
    if not interface.clock:
        return None
    mine = [reset for reset in resets if reset.clock == interface.clock]
    stated = [reset.port for reset in mine if reset.why == "stated"]
    if len(stated) == 1 or not _clocked(interface):
        return stated[0] if stated else None
    clock = (interface.clock,)
    domains = reset_domains(tuple(reset.port for reset in mine), clock)
    alike = [port for port, found in domains.items() if found == clock_domains(clock)[interface.clock]]
    if len(alike) == 1:
        return alike[0]
    found = _by_name(interface.name, {port: "_".join(found) for port, found in domains.items()})
    return found or next(iter(domains), None)


def _clocked(interface: Interface) -> bool:
    """Whether the protocol is synchronous; for others (gpio, iic, …) only attributes give a clock."""
    return interface.protocol.startswith("axi") or interface.found_by is FoundBy.PROTOCOL_FILE


def _by_name(name: str, domains: Mapping[str, str], *, sure: bool = True) -> str | None:
    """The port whose domain fits the name best; else the only port, or the only one with a bare name."""
    if best := best_fit(name, domains):
        return best
    bare = [port for port, domain in domains.items() if domain in _BARE]
    if len(bare) == 1:
        return bare[0]
    return next(iter(domains)) if len(domains) == 1 and sure else None


def best_fit(name: str, domains: Mapping[str, str]) -> str:
    """Return the port whose domain fits the name better than those of all others; "" if there is none."""
    scored = [(score, port) for port, domain in domains.items() if (score := _score(name, domain))]
    best = max(scored, default=(0, ""), key=lambda item: item[0])
    return best[1] if [score for score, _ in scored].count(best[0]) == 1 else ""


def _score(name: str, other: str) -> int:
    """Rate how well two names fit: by leading words that agree, then the same without s/m, then by words in common."""
    left, right = _normal(name), _normal(other)
    if common := _leading(left, right):
        return 8 * common + 4 * (len(left) == len(right))
    left, right = [word for word in left if word not in _SIDES], [word for word in right if word not in _SIDES]
    if common := _leading(left, right):
        return 2 * common + (len(left) == len(right))
    return len((set(left) & set(right)) - _PROTOCOL_WORDS)


def _leading(left: list[str], right: list[str]) -> int:
    """Count the words in common if one name begins with the other."""
    common = min(len(left), len(right))
    return common if left[:common] == right[:common] else 0


def _normal(name: str) -> list[str]:
    return ["axi" if word == "axi4" else word for word in words(name)]
