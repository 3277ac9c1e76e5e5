# SPDX-License-Identifier: Apache-2.0
"""Gathers a module's X_INTERFACE attributes into interfaces, clocks, resets and interrupts.

Vivado's interface attributes (UG994, "Using X_INTERFACE_INFO"), which take precedence over names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from cm.design.hdl.axi_signals import Protocol, make_protocol
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
from cm.frozen import dataclass, field, replace

_INFO = re.compile(
    r"\s*(?P<vlnv>[\w.-]+[:/][\w.-]+[:/](?P<kind>[\w.-]+)[:/][\w.-]+)\s+(?P<bus>\S+)\s+(?P<signal>\S+)\s*"
)
_PARAMETER = re.compile(r"\s*(\w+)\s+(.*)", re.DOTALL)
_TRUE = ("true", "1", "yes")


def parameters(port: Port) -> dict[str, str]:
    """X_INTERFACE_PARAMETER as a mapping, keys upper case: "POLARITY ACTIVE_LOW, FREQ_HZ 100000000"."""
    found: dict[str, str] = {}
    for text in port.attributes.get("x_interface_parameter", "").split(",") if port.attributes else ():
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


def clock_of(name: str, port: Port, stated: Mapping[str, str]) -> ModuleClock:
    """A clock with what its parameters say of it."""
    frequency = stated.get("FREQ_HZ", "")
    return ModuleClock(
        name,
        port.name,
        port.direction,
        int(frequency) if frequency.isdigit() else None,
        names(stated, "ASSOCIATED_BUSIF"),
        None,
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
    said |= {port.lower(): ("interrupt", []) for port in stated.interrupts or ()}
    ports = (_said(port, *said[port.name.lower()]) if port.name.lower() in said else port for port in module.ports)
    return replace(module, ports=tuple(ports))


def with_buses(module: ModuleInfo, described: ModuleInfo) -> ModuleInfo:
    """Return a module whose ports have their places in the AXI buses of `described` as attributes."""
    said: dict[str, Mapping[str, str]] = {}
    for bus in described.interfaces:
        if bus.protocol.startswith("axi") and bus.vlnv and bus.mode is not Mode.MONITOR:
            for signal, port in bus.ports.items():
                info = {"x_interface_info": f"{bus.vlnv} {bus.name} {signal}", "x_interface_mode": bus.mode.value}
                said[port.lower()] = info
    ports = (replace(port, attributes={**said.get(port.name.lower(), {}), **port.attributes}) for port in module.ports)
    return replace(module, ports=tuple(ports))


def _said(port: Port, kind: str, texts: list[str]) -> Port:
    signal = {"clock": "CLK", "reset": "RST", "interrupt": "INTERRUPT"}[kind]
    info = f"xilinx.com:signal:{kind}:1.0 {port.name} {signal}"
    mine = {"x_interface_info": info, **port.attributes}
    if not texts:
        return replace(port, attributes=mine)
    whole = ", ".join(filter(None, (port.attributes.get("x_interface_parameter", ""), *texts)))
    return replace(port, attributes={**mine, "x_interface_parameter": whole})


@dataclass(slots=True)
class Tagged:
    """The gathered result; `rejected` has a reason by port, `malformed` ports whose X_INTERFACE_INFO is none."""

    interfaces: list[Interface] = field(default_factory=list)
    clocks: list[ModuleClock] = field(default_factory=list)
    resets: list[Reset] = field(default_factory=list)
    interrupts: list[Interrupt] = field(default_factory=list)
    rejected: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    malformed: dict[str, Port] = field(default_factory=dict)


def read_tags(ports: Iterable[Port], protocols: Mapping[str, Protocol]) -> Tagged:
    """Gather the X_INTERFACE_INFO of all ports; `protocols` by the name in their VLNV (aximm, axis)."""
    result = Tagged()
    groups: dict[tuple[str, str], tuple[str, dict[str, Port]]] = {}  # by type and bus: its name, ports by signal
    for port in ports:
        for text in filter(str.strip, port.attributes.get("x_interface_info", "").split(",")):
            match = _INFO.fullmatch(text)
            if match is None:
                result.malformed[port.name] = port
            elif match["kind"].lower() in _SIGNAL_KINDS:
                _signal(match["kind"].lower(), match["bus"], port, result)
            else:
                key = (match["vlnv"].replace("/", ":"), match["bus"].lower())
                groups.setdefault(key, (match["bus"], {}))[1][match["signal"].upper()] = port
    for (vlnv, _), (bus, group) in groups.items():
        _bus(vlnv, bus, group, protocols, result)
    return result


def _signal(kind: str, name: str, port: Port, result: Tagged) -> None:
    stated = parameters(port)
    if kind == "clock":
        result.clocks.append(clock_of(name, port, stated))
    elif kind == "reset":
        polarity = polarity_of(stated) or reset_polarity(port.name)
        result.resets.append(Reset(name, port.name, polarity, port.direction))
    else:
        mode = Mode.MASTER if port.direction is PortDirection.OUT else Mode.SLAVE
        sense = stated.get("SENSITIVITY", "")
        result.interrupts.append(Interrupt(name, port.name, mode, port.width, sense))


def _bus(vlnv: str, bus: str, ports: dict[str, Port], protocols: Mapping[str, Protocol], result: Tagged) -> None:
    given: dict[str, str] = {}
    for port in ports.values():
        given.update(parameters(port))
    stated = next((mode for port in ports.values() if (mode := _stated_mode(port))), None)
    kind = vlnv.split(":")[2].lower()
    known = protocols.get(kind)
    if known is None:
        mode = stated or _guess(bus, ports)
        if stated is None:
            text = f"the mode of {bus} ({vlnv}) is a guess from its name and directions: {mode.value}"
            result.problems.append(f"{text}; state it with X_INTERFACE_MODE")
        protocol = make_protocol(kind, [], vlnv=vlnv)
        result.interfaces.append(make_interface(bus, protocol, mode, ports, FoundBy.ATTRIBUTE, given))
        return
    for signal in [signal for signal in ports if signal not in known.signals]:
        result.problems.append(f"port {ports[signal].name}: {known.name} has no signal {signal}")
        result.rejected[ports.pop(signal).name] = f"is marked as {signal}, which {known.name} does not have"
    if not ports:
        return
    verdict = judge(bus, known, ports, trusted=True)
    found = stated if stated is Mode.MONITOR else verdict.mode
    if found is None:
        result.problems.append(verdict.reason)
        result.rejected.update({port.name: verdict.reason for port in ports.values()})
        return
    result.interfaces.append(make_interface(bus, known, found, ports, FoundBy.ATTRIBUTE, given))


def _guess(bus: str, ports: Mapping[str, Port]) -> Mode:
    """Guess the mode for a protocol whose directions are not known here: by name, or by which side drives more."""
    words = bus.lower().split("_")
    if words[0] in ("m", "master", "source", "initiator"):
        return Mode.MASTER
    if words[0] in _SLAVE_WORDS:
        return Mode.SLAVE
    driven = sum(1 if port.direction is PortDirection.OUT else -1 for port in ports.values())
    return Mode.MASTER if driven >= 0 else Mode.SLAVE
