# SPDX-License-Identifier: Apache-2.0
"""Gathers a module's X_INTERFACE attributes into interfaces, clocks, resets and interrupts.

Vivado's interface attributes (UG994, "Using X_INTERFACE_INFO"), which take precedence over names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from cm.design.hdl.buses import Protocol, make_protocol
from cm.design.hdl.clock_reset_names import reset_polarity
from cm.design.hdl.model import (
    FoundBy,
    Interface,
    Interrupt,
    Mode,
    ModuleClock,
    ModuleInfo,
    Polarity,
    Port,
    PortDirection,
    Reset,
    Stated,
)
from cm.design.hdl.validate_bus import judge, make_interface

_INFO = re.compile(
    r"\s*(?P<vlnv>[\w.-]+[:/][\w.-]+[:/](?P<kind>[\w.-]+)[:/][\w.-]+)\s+(?P<bus>\S+)\s+(?P<signal>\S+)\s*"
)
_PARAMETER = re.compile(r"\s*(\w+)\s+(.*)", re.DOTALL)
_TRUE = ("true", "1", "yes")


@dataclass(frozen=True, slots=True)
class Tag:
    """One X_INTERFACE_INFO: the port is `signal` of the interface `bus` of type `vlnv`."""

    port: Port
    vlnv: str
    kind: str  # the VLNV's name: aximm, axis, clock, reset, interrupt, …
    bus: str
    signal: str


def tags(ports: Iterable[Port]) -> Iterator[Tag]:
    """All tags of all ports, in order; a malformed one is left out (`malformed` tells)."""
    for port in ports:
        for match in _infos(port):
            if match is not None:
                vlnv = match["vlnv"].replace("/", ":")
                yield Tag(port, vlnv, match["kind"].lower(), match["bus"], match["signal"].upper())


def malformed(ports: Iterable[Port]) -> Iterator[Port]:
    """Ports whose X_INTERFACE_INFO is not "vendor:library:name:version BUS SIGNAL"."""
    return (port for port in ports if any(match is None for match in _infos(port)))


def _infos(port: Port) -> Iterator[re.Match[str] | None]:
    for text in port.attributes.get("x_interface_info", "").split(","):
        if text.strip():
            yield _INFO.fullmatch(text)


def parameters(port: Port) -> dict[str, str]:
    """X_INTERFACE_PARAMETER as a mapping, keys upper case: "POLARITY ACTIVE_LOW, FREQ_HZ 100000000"."""
    found: dict[str, str] = {}
    for text in port.attributes.get("x_interface_parameter", "").split(","):
        if match := _PARAMETER.fullmatch(text):
            found[match[1].upper()] = match[2].strip()
    return found


def ignored(port: Port) -> bool:
    """X_INTERFACE_IGNORE is set: no interface may be inferred from the name."""
    return port.attributes.get("x_interface_ignore", "").lower() in _TRUE


def _stated_mode(port: Port) -> Mode | None:
    """X_INTERFACE_MODE: "slave", "Slave S_AXI", "monitor", …"""
    word = port.attributes.get("x_interface_mode", "").lower().partition(" ")[0].removeprefix("mirrored")
    return next((mode for mode in Mode if mode.value == word), None)


def names(parameters: Mapping[str, str], key: str) -> tuple[str, ...]:
    """The names of a colon-separated list such as ASSOCIATED_BUSIF."""
    return tuple(name for name in parameters.get(key, "").split(":") if name)


def clock_of(name: str, port: Port, stated: Mapping[str, str], found_by: FoundBy) -> ModuleClock:
    """A clock with what its parameters say of it."""
    frequency = stated.get("FREQ_HZ", "")
    return ModuleClock(
        name,
        port.name,
        port.direction,
        int(frequency) if frequency.isdigit() else None,
        names(stated, "ASSOCIATED_BUSIF"),
        None,
        found_by,
        names(stated, "ASSOCIATED_RESET"),
    )


def polarity_of(stated: Mapping[str, str]) -> Polarity | None:
    """The polarity that a reset's parameters say."""
    return {"ACTIVE_LOW": Polarity.LOW, "ACTIVE_HIGH": Polarity.HIGH}.get(stated.get("POLARITY", "").upper())


_SIGNAL_KINDS = ("clock", "reset", "interrupt")
_SLAVE_WORDS = ("s", "slave", "sink", "target")


def with_statements(module: ModuleInfo, stated: Stated) -> ModuleInfo:
    """Return a module whose ports have what the build schema says as attributes, behind those of the HDL."""
    said: dict[str, tuple[str, list[str]]] = {}
    for port, buses in stated.clocks.items():
        said.setdefault(port.lower(), ("clock", []))[1].append(f"ASSOCIATED_BUSIF {':'.join(buses)}")
    for port, (clock, polarity) in stated.resets.items():
        words = [f"POLARITY ACTIVE_{polarity.value.upper()}"] if polarity else []
        said.setdefault(port.lower(), ("reset", []))[1].extend(words)
        if clock is not None:
            mine = [name for name, (other, _) in stated.resets.items() if other == clock]
            text = f"ASSOCIATED_RESET {':'.join(mine)}"
            known = said.setdefault(clock.lower(), ("clock", []))[1]
            known += [text] if text not in known else []
    ports = (_said(port, *said[port.name.lower()]) if port.name.lower() in said else port for port in module.ports)
    return replace(module, ports=tuple(ports))


def _said(port: Port, kind: str, texts: list[str]) -> Port:
    signal = {"clock": "CLK", "reset": "RST"}[kind]
    info = f"xilinx.com:signal:{kind}:1.0 {port.name} {signal}"
    mine = {"x_interface_info": info, **port.attributes}
    if not texts:
        return replace(port, attributes=mine)
    whole = ", ".join(filter(None, (port.attributes.get("x_interface_parameter", ""), *texts)))
    return replace(port, attributes={**mine, "x_interface_parameter": whole})


@dataclass(slots=True)
class Tagged:
    """The gathered result; `rejected` has a reason by port."""

    interfaces: list[Interface] = field(default_factory=list)
    clocks: list[ModuleClock] = field(default_factory=list)
    resets: list[Reset] = field(default_factory=list)
    interrupts: list[Interrupt] = field(default_factory=list)
    rejected: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def read_tags(ports: Iterable[Port], protocols: Mapping[str, Protocol]) -> Tagged:
    """Gather the tags of all ports; `protocols` by the name in their VLNV (aximm, axis)."""
    result = Tagged()
    groups: dict[tuple[str, str], list[Tag]] = {}
    for tag in tags(ports):
        if tag.kind in _SIGNAL_KINDS:
            _signal(tag, result)
        else:
            groups.setdefault((tag.vlnv, tag.bus.lower()), []).append(tag)
    for group in groups.values():
        _bus(group, protocols, result)
    return result


def _signal(tag: Tag, result: Tagged) -> None:
    port, stated = tag.port, parameters(tag.port)
    if tag.kind == "clock":
        result.clocks.append(clock_of(tag.bus, port, stated, FoundBy.ATTRIBUTE))
    elif tag.kind == "reset":
        polarity = polarity_of(stated) or reset_polarity(port.name)
        result.resets.append(Reset(tag.bus, port.name, polarity, port.direction, FoundBy.ATTRIBUTE))
    else:
        mode = Mode.MASTER if port.direction is PortDirection.OUT else Mode.SLAVE
        sense = stated.get("SENSITIVITY", "")
        result.interrupts.append(Interrupt(tag.bus, port.name, mode, port.width, sense, FoundBy.ATTRIBUTE))


def _bus(group: list[Tag], protocols: Mapping[str, Protocol], result: Tagged) -> None:
    first = group[0]
    ports = {tag.signal: tag.port for tag in group}
    given: dict[str, str] = {}
    for tag in group:
        given.update(parameters(tag.port))
    stated = next((mode for tag in group if (mode := _stated_mode(tag.port))), None)
    known = protocols.get(first.kind)
    if known is None:
        mode = stated or _guess(first.bus, ports)
        if stated is None:
            text = f"the mode of {first.bus} ({first.vlnv}) is a guess from its name and directions: {mode.value}"
            result.problems.append(f"{text}; state it with X_INTERFACE_MODE")
        protocol = make_protocol(first.kind, [], vlnv=first.vlnv)
        result.interfaces.append(make_interface(first.bus, protocol, mode, ports, FoundBy.ATTRIBUTE, given))
        return
    strange = [signal for signal in ports if signal not in known.signals]
    for signal in strange:
        result.problems.append(f"port {ports[signal].name}: {known.name} has no signal {signal}")
        result.rejected[ports.pop(signal).name] = f"is marked as {signal}, which {known.name} does not have"
    if not ports:
        return
    verdict = judge(first.bus, known, ports, trusted=True)
    mode_ = stated if stated is Mode.MONITOR else verdict.mode
    if mode_ is None:
        result.problems.append(verdict.reason)
        result.rejected.update({port.name: verdict.reason for port in ports.values()})
        return
    result.interfaces.append(make_interface(first.bus, known, mode_, ports, FoundBy.ATTRIBUTE, given))


def _guess(bus: str, ports: Mapping[str, Port]) -> Mode:
    """Guess the mode for a protocol whose directions are not known here: by name, or by which side drives more."""
    words = bus.lower().split("_")
    if words[0] in ("m", "master", "source", "initiator"):
        return Mode.MASTER
    if words[0] in _SLAVE_WORDS:
        return Mode.SLAVE
    driven = sum(1 if port.direction is PortDirection.OUT else -1 for port in ports.values())
    return Mode.MASTER if driven >= 0 else Mode.SLAVE
