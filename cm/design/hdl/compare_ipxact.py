# SPDX-License-Identifier: Apache-2.0
"""Compares HDL with its IP-XACT description."""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.hdl.model import Interface, ModuleInfo
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference: `kind` is missing, extra, ports, protocol, mode, clock or port; `name`: what differs."""

    kind: str
    name: str
    message: str

    def __str__(self) -> str:
        return self.message


def compare(extracted: ModuleInfo, ipxact: ModuleInfo) -> list[Difference]:
    """Return all differences, bus interfaces first; interfaces are matched by the ports they share, not by name.

    Interfaces that only IP-XACT or attributes can declare (gpio, bram, …) and that the extraction did not find
    are no difference: port names do not reveal them.
    """
    return [*_interfaces(extracted, ipxact), *_ports(extracted, ipxact)]


def _interfaces(extracted: ModuleInfo, ipxact: ModuleInfo) -> Iterator[Difference]:
    matched = set()
    for stated in ipxact.interfaces:
        if not stated.protocol.startswith("axi") or not stated.ports:
            continue
        found = _match(stated, extracted)
        if found is None:
            text = f"IP-XACT has the {stated.protocol} {stated.mode.value} {stated.name}, the HDL shows none"
            yield Difference("missing", stated.name, text)
            continue
        matched.add(found.name)
        yield from _one(found, stated)
    for found in extracted.interfaces:
        if found.protocol.startswith("axi") and found.name not in matched:
            text = f"the HDL shows the {found.protocol} {found.mode.value} {found.name}, IP-XACT has none"
            yield Difference("extra", found.name, text)


def _match(stated: Interface, extracted: ModuleInfo) -> Interface | None:
    ports = {port.lower() for port in stated.ports.values()}

    def shared(interface: Interface) -> int:
        return len(ports & {port.lower() for port in interface.ports.values()})

    best = max(extracted.interfaces, key=shared, default=None)
    return best if best is not None and shared(best) else None


def _one(found: Interface, stated: Interface) -> Iterator[Difference]:
    ours = {signal: port.lower() for signal, port in found.ports.items()}
    theirs = {signal: port.lower() for signal, port in stated.ports.items()}
    if ours != theirs:
        only_ours = sorted(set(ours.items()) - set(theirs.items()))
        only_theirs = sorted(set(theirs.items()) - set(ours.items()))
        text = f"{stated.name}: only the HDL maps {_pairs(only_ours)}; only IP-XACT maps {_pairs(only_theirs)}"
        yield Difference("ports", stated.name, text)
    for kind, left, right in (
        ("protocol", found.protocol, stated.protocol),
        ("mode", found.mode.value, stated.mode.value),
        ("clock", found.clock, stated.clock or found.clock),
    ):
        if left != right:
            yield Difference(kind, stated.name, f"{stated.name}: {kind} is {left} in the HDL, {right} in IP-XACT")


def _pairs(pairs: list[tuple[str, str]]) -> str:
    return ", ".join(f"{signal}={port}" for signal, port in pairs) or "nothing"


def _ports(extracted: ModuleInfo, ipxact: ModuleInfo) -> Iterator[Difference]:
    ours = {port.name.lower(): port for port in extracted.ports}
    theirs = {port.name.lower(): port for port in ipxact.ports}
    for name in (name for name in theirs if name not in ours):
        yield Difference("port", theirs[name].name, f"port {theirs[name].name} is in IP-XACT only")
    for name in (name for name in ours if name not in theirs):
        yield Difference(
            "port", ours[name].name, f"port {ours[name].name} is in the HDL only: IP-XACT lacks or disables it"
        )
    for name, port in ours.items():
        other = theirs.get(name)
        if other is None:
            continue
        if port.direction is not other.direction:
            text = f"port {port.name} is {port.direction.value} in the HDL, {other.direction.value} in IP-XACT"
            yield Difference("port", port.name, text)
        elif port.width and other.width and port.width != other.width:
            text = f"port {port.name} has {port.width} bits in the HDL, {other.width} in IP-XACT"
            yield Difference("port", port.name, text)
