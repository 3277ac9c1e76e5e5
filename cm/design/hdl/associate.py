# SPDX-License-Identifier: Apache-2.0
"""Finds the clock and the reset of an interface: as declared, or by name, or the only one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from cm.design.hdl.clock_reset_names import stem, words
from cm.design.hdl.model import FoundBy, Interface, ModuleClock, Problem, Reset

_BARE = ("", "ap", "axi", "axis")  # the stems of aclk, ap_clk, axi_aclk
_SIDES = frozenset(["s", "m", "i", "o", "in", "out", "slave", "master"])
_PROTOCOL_WORDS = frozenset(["axi", "axis", "axil", "lite", "full", "stream", "bus", "data"])


@dataclass(frozen=True, slots=True)
class Associated:
    """Interfaces with their clocks and vice versa, and what could not be determined."""

    interfaces: tuple[Interface, ...]
    clocks: tuple[ModuleClock, ...]
    problems: tuple[Problem, ...]


def associate(
    interfaces: Iterable[Interface],
    clocks: Sequence[ModuleClock],
    resets: Sequence[Reset],
    file: str,
    *,
    sure: bool = True,
) -> Associated:
    """Fill in `clock`, `reset` and `reset_polarity` of the interfaces, and `interfaces` of the clocks.

    `sure` is False if the module drives clocks too: then being the only clock input proves nothing.
    """
    done, problems = [], []
    for interface in interfaces:
        clock = _clock(interface, clocks, sure)
        reset = _reset(interface, clock, clocks, resets)
        polarity = next((item.polarity for item in resets if item.port == reset), None)
        done.append(replace(interface, clock=clock, reset=reset, reset_polarity=polarity))
        if clock is None and interface.protocol.startswith("axi"):
            problems.append(Problem(_no_clock(interface, clocks), file))
    return Associated(tuple(done), tuple(_with_interfaces(clock, done) for clock in clocks), tuple(problems))


def _no_clock(interface: Interface, clocks: Sequence[ModuleClock]) -> str:
    known = f"the clocks are {', '.join(clock.port for clock in clocks)}" if clocks else "no port is named as a clock"
    hint = f'state it with X_INTERFACE_PARAMETER = "ASSOCIATED_BUSIF {interface.name}" on the clock'
    return f"the clock of {interface.name} could not be determined: {known}; {hint}"


def _with_interfaces(clock: ModuleClock, interfaces: Sequence[Interface]) -> ModuleClock:
    names = tuple(interface.name for interface in interfaces if interface.clock == clock.port)
    reset = clock.reset or next((i.reset for i in interfaces if i.clock == clock.port and i.reset), None)
    return replace(clock, interfaces=names, reset=reset)


def _clock(interface: Interface, clocks: Sequence[ModuleClock], sure: bool) -> str | None:
    if interface.clock:
        return interface.clock
    for clock in clocks:
        if interface.name.lower() in (name.lower() for name in clock.interfaces):
            return clock.port
    if not _clocked(interface):
        return None
    return _by_name(interface.name, [clock.port for clock in clocks], sure=sure)


def _reset(
    interface: Interface, clock: str | None, clocks: Sequence[ModuleClock], resets: Sequence[Reset]
) -> str | None:
    if interface.reset:
        return interface.reset
    stated = next((item.reset for item in clocks if item.port == clock and item.reset), None)
    if stated:
        return stated
    if not _clocked(interface):
        return None
    ports = [reset.port for reset in resets]
    return _by_name(interface.name, ports) or (_by_name(stem(clock), ports) if clock else None)


def _clocked(interface: Interface) -> bool:
    """Whether the protocol is synchronous; for others (gpio, iic, …) only attributes give a clock."""
    return interface.protocol.startswith("axi") or interface.found_by is FoundBy.PROTOCOL_FILE


def _by_name(name: str, ports: Sequence[str], *, sure: bool = True) -> str | None:
    """The port whose stem fits the name best; else the only port, or the only one with a bare name."""
    scored = [(score, port) for port in ports if (score := _score(name, stem(port)))]
    best = max(scored, default=(0, ""), key=lambda item: item[0])
    if best[0] and [score for score, _ in scored].count(best[0]) == 1:
        return best[1]
    bare = [port for port in ports if stem(port) in _BARE]
    if len(bare) == 1:
        return bare[0]
    return ports[0] if len(ports) == 1 and sure else None


def _score(name: str, other: str) -> int:
    """Rate how well two names fit: by leading words that agree, then the same without s/m, then by words in common."""
    left, right = _normal(name), _normal(other)
    if common := _leading(left, right):
        return 8 * common + 4 * (len(left) == len(right))
    left, right = [word for word in left if word not in _SIDES], [word for word in right if word not in _SIDES]
    if common := _leading(left, right):
        return 2 * common + (len(left) == len(right))
    return int(bool((set(left) & set(right)) - _PROTOCOL_WORDS))


def _leading(left: list[str], right: list[str]) -> int:
    """Count the words in common if one name begins with the other."""
    common = min(len(left), len(right))
    return common if left[:common] == right[:common] else 0


def _normal(name: str) -> list[str]:
    return ["axi" if word == "axi4" else word for word in words(name)]
