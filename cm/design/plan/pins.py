# SPDX-License-Identifier: Apache-2.0
"""Ports of the top, and the package pins that the build schema assigns to them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.design.boards import Pin
from cm.design.errors import BuildError
from cm.design.plan.system import RegionPlan, System
from cm.design.project.model import ConnectionSpec
from cm.frozen import dataclass
from cm.schema.problems import KeyPath

_RAW = re.compile(r"[A-Z]{1,2}\d{1,2}")
_PORTS = re.compile(r"get_ports\s+(?:-\w+\s+)*(\{[^}]*\}|[^\]\s]+(?:\[\d+\])?)")


@dataclass(frozen=True, slots=True)
class External:
    """A port of the top for a signal of a region's interface; `signal` is empty for a single signal."""

    port: str
    width: int
    signal: str
    key: KeyPath
    spec: ConnectionSpec


@dataclass(frozen=True, slots=True)
class Placement:
    """A bit of a port on a package pin."""

    target: str  # as an argument of get_ports
    pin: Pin


@dataclass(frozen=True, slots=True)
class PinFault:
    """A port without a pin (`missing`) or with a wrong one, and the reason."""

    key: KeyPath
    port: str
    message: str
    missing: bool = False


def externals(system: System) -> Iterator[External]:
    """Ports of the top other than the processing system's own, in the order of regions."""
    for region in system.regions:
        for bus in region.streams:
            if bus.external:
                yield from _stream(region, bus.interface.name, bus.name, dict(bus.interface.widths))
        for port in region.external:
            name = port.interface or port.name
            signal = port.logical.lower() if port.interface else ""
            key = ("regions", region.name, "interfaces", name)
            spec = region.spec.interfaces.get(name, ConnectionSpec())
            yield External(f"ext_{region.name}_{port.name}", port.width, signal, key, spec)


def _stream(region: RegionPlan, name: str, bus: str, widths: Mapping[str, int | None]) -> Iterator[External]:
    key = ("regions", region.name, "interfaces", name)
    spec = region.spec.interfaces.get(name, ConnectionSpec())
    payload = [signal for signal in widths if signal not in ("TVALID", "TREADY", "TLAST")]
    for signal in ("TVALID", "TREADY", "TLAST", *payload):
        low = signal.lower()
        yield External(f"axis_{bus}_{low}", widths.get(signal) or 1, low, key, spec)


def placements(system: System) -> tuple[list[Placement], list[PinFault]]:
    """The pins of all ports, and the faults in them."""
    found: list[Placement] = []
    faults: list[PinFault] = []
    elsewhere = _in_constraints(system.project.static.constraints)
    for port in externals(system):
        given = port.spec.pins.get(port.signal)
        if given is None:
            if not any(_matches(pattern, port.port) for pattern in elsewhere):
                message = f"{port.port} ({port.width} bit{'s' if port.width > 1 else ''}) has no pin"
                faults.append(PinFault(port.key, port.port, message, missing=True))
            continue
        try:
            found += _place(system, port, given)
        except BuildError as error:
            faults.append(PinFault((*port.key, "pins"), port.port, str(error)))
    faults += _unknown(system)
    return found, faults + list(_twice(found))


def _place(system: System, port: External, given: tuple[str, ...]) -> Iterator[Placement]:
    pins = [pin for text in given for pin in _pins(system, text, port.spec.iostandard)]
    if len(pins) != port.width:
        raise BuildError(f"{port.port} has {port.width} bits, {len(pins)} pins are given")
    for index, pin in enumerate(pins):
        yield Placement(port.port if port.width == 1 else f"{port.port}[{index}]", pin)


def _pins(system: System, text: str, iostandard: str | None) -> tuple[Pin, ...]:
    """Find pins by their name on the board or on the package."""
    if _RAW.fullmatch(text):
        if iostandard is None:
            raise BuildError(f"{text} is a package pin: iostandard: must say its voltage, such as LVCMOS33")
        return (Pin(text, text, iostandard),)
    if system.project.kit is None:
        raise BuildError(f"{text} is not a package pin, and project.board is none of the board library's")
    return system.project.kit.pins(text)


def _unknown(system: System) -> Iterator[PinFault]:
    """Faults for signals in `pins` that the interface does not have."""
    known: dict[KeyPath, set[str]] = {}
    for port in externals(system):
        known.setdefault(port.key, set()).add(port.signal)
    for region in system.regions:
        for name, spec in region.spec.interfaces.items():
            key: KeyPath = ("regions", region.name, "interfaces", name)
            for signal in spec.pins:
                if signal not in known.get(key, set()):
                    there = ", ".join(sorted(known.get(key, set()) - {""})) or "no port of the top"
                    yield PinFault((*key, "pins"), name, f"{name} has no {signal or 'single signal'}: there is {there}")


def _twice(found: list[Placement]) -> Iterator[PinFault]:
    first: dict[str, str] = {}
    for one in found:
        if one.pin.location in first:
            message = f"{one.target} and {first[one.pin.location]} are both on {one.pin.location} ({one.pin.name})"
            yield PinFault(("regions",), one.target, message)
        first.setdefault(one.pin.location, one.target)


def _in_constraints(paths: tuple[Path, ...]) -> set[str]:
    """Patterns of ports for which the user's XDC files give both a pin and a standard."""
    located: set[str] = set()
    standard: set[str] = set()
    for path in paths:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            text = line.split("#", 1)[0]
            names = {name for group in _PORTS.findall(text) for name in group.strip("{} ").split()}
            if re.search(r"\b(PACKAGE_PIN|LOC)\b", text):
                located |= names
            if "IOSTANDARD" in text:
                standard |= names
    return {name for name in located if any(_matches(other, name) for other in standard)}


def _matches(pattern: str, port: str) -> bool:
    """A pattern of get_ports, `*` and an index in brackets, against a port's name."""
    plain = re.sub(r"\[\d+\]$", "", pattern)
    return re.fullmatch(re.escape(plain).replace(r"\*", ".*"), re.sub(r"\[\d+\]$", "", port)) is not None
