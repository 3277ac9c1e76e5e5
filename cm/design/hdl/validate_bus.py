# SPDX-License-Identifier: Apache-2.0
"""Judges candidates: a bus has consistent directions, handshakes of one bit, and all that its protocol requires."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from cm.design.hdl.axi_signals import Protocol, axi_flavour
from cm.design.hdl.model import FoundBy, Interface, Mode, Port
from cm.frozen import dataclass

_DATA_WIDTHS = frozenset(8 << power for power in range(8))  # IHI 0022, A1.2.1
_ACE_RESPONSE = 4  # bits of RRESP (IHI 0022, D3.5)
_TITLES = {"aximm": "AXI", "axis": "AXI4-Stream"}


@dataclass(frozen=True, slots=True)
class Verdict:
    """The mode, or the reason why these ports are not a bus."""

    mode: Mode | None
    reason: str = ""


def judge(name: str, protocol: Protocol, ports: Mapping[str, Port], *, trusted: bool = False) -> Verdict:
    """Whether these ports are one bus of the protocol; `trusted`: the designer said so, so parts may be missing."""
    what = f"looks like the {_TITLES.get(protocol.name, protocol.name)} bus {name}"
    if wide := _wide(protocol, ports):
        return Verdict(None, f"{what}, but {wide}")
    masters, slaves = _directions(protocol, ports)
    if masters and slaves:
        return Verdict(None, f"{what}, but its directions are mixed ({_mixed(masters, slaves)}): a monitor, or no bus")
    if not masters and not slaves:
        return Verdict(None, f"{what}, but no port has a direction that determines the mode")
    missing = _missing(protocol, ports)
    if missing and not trusted:
        return Verdict(None, f"{what}, but {missing}")
    if not trusted and (odd := _odd(protocol, ports)):
        return Verdict(None, f"{what}, but {odd}")
    return Verdict(Mode.MASTER if masters else Mode.SLAVE)


def _wide(protocol: Protocol, ports: Mapping[str, Port]) -> str:
    for signal, port in ports.items():
        if not protocol.signals[signal].handshake or port.width == 1:
            continue
        if port.width is None:
            return f"the width of {port.name} could not be evaluated"
        return f"{port.name} has {port.width} bits: several buses side by side, needs a flat wrapper that splits them"
    return ""


def _odd(protocol: Protocol, ports: Mapping[str, Port]) -> str:
    """What a width says against the protocol."""
    for signal, port in ports.items():
        allowed = protocol.signals[signal].widths
        if port.width is None or not allowed or port.width in allowed:
            continue
        if signal == "RRESP" and port.width == _ACE_RESPONSE:
            return f"{port.name} has {port.width} bits: it is ACE, coherent AXI, which a region's ports do not take"
        bits = " or ".join(map(str, allowed))
        return f"{port.name} has {port.width} bits, and {signal} has {bits}: no AXI, or of a wrapper around it"
    data, strobes = ports.get("WDATA"), ports.get("WSTRB")
    known = data is not None and data.width in _DATA_WIDTHS  # else a parameter without a value that can be
    if known and data and strobes and strobes.width and strobes.width * 8 != data.width:
        return (
            f"{strobes.name} has {strobes.width} bits for the {data.width} of {data.name}: WSTRB has one for each byte"
        )
    return ""


def _directions(protocol: Protocol, ports: Mapping[str, Port]) -> tuple[list[str], list[str]]:
    """Ports whose direction is a master's, and those whose direction is a slave's or neither."""
    masters = [port.name for signal, port in ports.items() if port.direction is protocol.signals[signal].direction]
    return masters, [port.name for port in ports.values() if port.name not in masters]


def _mixed(masters: list[str], slaves: list[str]) -> str:
    few, many = sorted((masters, slaves), key=len)
    return f"{_some(few)} against {_some(many)}"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (", …" if len(names) > 3 else "")


def _missing(protocol: Protocol, ports: Mapping[str, Port]) -> str:
    lacking = [name for name, signal in protocol.signals.items() if signal.required and name not in ports]
    if lacking:
        return _lacking(lacking)
    if protocol.company and set(ports) <= {"TVALID", "TLAST"}:
        return "it is one signal alone" if len(ports) == 1 else "it has neither data nor ready"
    if not protocol.halves:
        return ""
    gaps = [sorted(half - set(ports)) for half in protocol.halves]
    if any(not gap for gap in gaps):
        return ""
    return _lacking(min(gaps, key=lambda gap: (len(gap), gap)))


def _lacking(names: Sequence[str]) -> str:
    return f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} missing"


def make_interface(
    name: str,
    protocol: Protocol,
    mode: Mode,
    ports: Mapping[str, Port],
    found_by: FoundBy,
    parameters: Mapping[str, str] | None = None,
) -> Interface:
    """Make the interface of ports that were accepted; logical signals are in the protocol's order."""
    given = parameters or {}
    order = {signal: number for number, signal in enumerate(protocol.signals)}
    ordered = sorted(ports.items(), key=lambda item: order.get(item[0], len(order)))
    return Interface(
        name=name,
        protocol=_flavour(protocol, ports, given),
        mode=mode,
        ports=MappingProxyType({signal: port.name for signal, port in ordered}),
        widths=MappingProxyType({signal: port.width for signal, port in ordered}),
        found_by=found_by,
        vlnv=protocol.vlnv,
        parameters=MappingProxyType(dict(given)),
    )


def _flavour(protocol: Protocol, ports: Mapping[str, Port], parameters: Mapping[str, str]) -> str:
    if protocol.name != "aximm":
        return protocol.name
    stated = parameters.get("PROTOCOL", "").lower()
    return stated if stated in ("axi4", "axi3", "axi4lite") else axi_flavour(ports)
