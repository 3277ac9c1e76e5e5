# SPDX-License-Identifier: Apache-2.0
"""Vivado's interface attributes (UG994, "Using X_INTERFACE_INFO"), which take precedence over names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from cm.design.hdl.model import Mode, Port

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


def mode(port: Port) -> Mode | None:
    """X_INTERFACE_MODE: "slave", "Slave S_AXI", "monitor", …"""
    word = port.attributes.get("x_interface_mode", "").lower().partition(" ")[0].removeprefix("mirrored")
    return next((mode for mode in Mode if mode.value == word), None)


def names(parameters: Mapping[str, str], key: str) -> tuple[str, ...]:
    """The names of a colon-separated list such as ASSOCIATED_BUSIF."""
    return tuple(name for name in parameters.get(key, "").split(":") if name)
