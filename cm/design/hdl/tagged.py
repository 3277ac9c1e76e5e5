# SPDX-License-Identifier: Apache-2.0
"""Gathers a module's X_INTERFACE attributes into interfaces, clocks, resets and interrupts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cm.design.hdl import attributes
from cm.design.hdl.attributes import Tag
from cm.design.hdl.buses import Protocol, make_protocol
from cm.design.hdl.judge import judge, make_interface
from cm.design.hdl.model import FoundBy, Interface, Interrupt, Mode, ModuleClock, Polarity, Port, PortDirection, Reset
from cm.design.hdl.signals import reset_polarity

_SIGNAL_KINDS = ("clock", "reset", "interrupt")
_SLAVE_WORDS = ("s", "slave", "sink", "target")


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
    for tag in attributes.tags(ports):
        if tag.kind in _SIGNAL_KINDS:
            _signal(tag, result)
        else:
            groups.setdefault((tag.vlnv, tag.bus.lower()), []).append(tag)
    for group in groups.values():
        _bus(group, protocols, result)
    return result


def _signal(tag: Tag, result: Tagged) -> None:
    port, stated = tag.port, attributes.parameters(tag.port)
    if tag.kind == "clock":
        frequency = stated.get("FREQ_HZ", "")
        busses = attributes.names(stated, "ASSOCIATED_BUSIF")
        reset = next(iter(attributes.names(stated, "ASSOCIATED_RESET")), None)
        hertz = int(frequency) if frequency.isdigit() else None
        result.clocks.append(ModuleClock(tag.bus, port.name, port.direction, hertz, busses, reset, FoundBy.ATTRIBUTE))
    elif tag.kind == "reset":
        result.resets.append(Reset(tag.bus, port.name, _polarity(port, stated), port.direction, FoundBy.ATTRIBUTE))
    else:
        mode = Mode.MASTER if port.direction is PortDirection.OUT else Mode.SLAVE
        sense = stated.get("SENSITIVITY", "")
        result.interrupts.append(Interrupt(tag.bus, port.name, mode, port.width, sense, FoundBy.ATTRIBUTE))


def _polarity(port: Port, stated: Mapping[str, str]) -> Polarity:
    word = stated.get("POLARITY", "").upper()
    if word in ("ACTIVE_LOW", "ACTIVE_HIGH"):
        return Polarity.LOW if word == "ACTIVE_LOW" else Polarity.HIGH
    return reset_polarity(port.name)


def _bus(group: list[Tag], protocols: Mapping[str, Protocol], result: Tagged) -> None:
    first = group[0]
    ports = {tag.signal: tag.port for tag in group}
    parameters: dict[str, str] = {}
    for tag in group:
        parameters.update(attributes.parameters(tag.port))
    stated = next((mode for tag in group if (mode := attributes.mode(tag.port))), None)
    known = protocols.get(first.kind)
    if known is None:
        mode = stated or _guess(first.bus, ports)
        if stated is None:
            text = f"the mode of {first.bus} ({first.vlnv}) is a guess from its name and directions: {mode.value}"
            result.problems.append(f"{text}; state it with X_INTERFACE_MODE")
        protocol = make_protocol(first.kind, [], vlnv=first.vlnv)
        result.interfaces.append(make_interface(first.bus, protocol, mode, ports, FoundBy.ATTRIBUTE, parameters))
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
    result.interfaces.append(make_interface(first.bus, known, mode_, ports, FoundBy.ATTRIBUTE, parameters))


def _guess(bus: str, ports: Mapping[str, Port]) -> Mode:
    """Guess the mode for a protocol whose directions are not known here: by name, or by which side drives more."""
    words = bus.lower().split("_")
    if words[0] in ("m", "master", "source", "initiator"):
        return Mode.MASTER
    if words[0] in _SLAVE_WORDS:
        return Mode.SLAVE
    driven = sum(1 if port.direction is PortDirection.OUT else -1 for port in ports.values())
    return Mode.MASTER if driven >= 0 else Mode.SLAVE
