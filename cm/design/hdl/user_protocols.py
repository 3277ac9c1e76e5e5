# SPDX-License-Identifier: Apache-2.0
"""The user's own protocols: a YAML file of names, signals and directions, for unconventional interfaces.

protocols:
  - name: pixels
    signals:                     # directions are the master's
      data:  {direction: out, width: 12, names: [pix]}
      valid: out
      ready: {direction: in, required: false}
    bindings:                    # only if the ports' names do not show it
      - {module: sensor, name: cam0, mode: slave, ports: {data: d, valid: dv}, clock: pclk}
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.hdl.axi_signals import Protocol, Signal, make_protocol
from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import Mode, PortDirection
from cm.design.project.load import DesignFile
from cm.frozen import dataclass
from cm.schema.problems import KeyPath
from cm.schema.tree import locate

SCHEMA_FILE = Path(__file__).parents[1] / "data" / "protocols.schema.json"
_RESERVED = ("axi4", "axi3", "axi4lite", "axis", "aximm", "clock", "reset", "interrupt")


@dataclass(frozen=True, slots=True)
class Binding:
    """One interface declared port by port; `where` is "file:line" for messages."""

    module: str
    name: str
    mode: Mode
    ports: Mapping[str, str]
    clock: str
    reset: str
    where: str


@dataclass(frozen=True, slots=True)
class UserProtocol:
    """A user's protocol, and the interfaces that are bound to it explicitly."""

    protocol: Protocol
    bindings: tuple[Binding, ...] = ()


def load_protocols(path: str | Path) -> tuple[UserProtocol, ...]:
    """Read a protocols file. Raises `SchemaError` with everything that is wrong, `HdlError` if it cannot be read."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise HdlError(f"{path}: cannot be read: {error}") from error
    return parse_protocols(text, str(path))


def parse_protocols(text: str, name: str = "protocols.yaml") -> tuple[UserProtocol, ...]:
    """Do as `load_protocols`, for text; `name` is used in messages."""
    file = DesignFile(text, Path(name), SCHEMA_FILE, "protocols:")
    found: dict[str, UserProtocol] = {}
    for index, spec in enumerate(file.values()["protocols"]):
        key: KeyPath = ("protocols", index)
        if spec["name"].lower() in _RESERVED:
            file.report((*key, "name"), "bad_name", f"{spec['name']} is built in", "choose another name")
        if spec["name"] in found:
            file.report((*key, "name"), "duplicate_name", f"the protocol {spec['name']} is defined twice")
        if not spec["signals"]:
            file.report((*key, "signals"), "missing_key", "a protocol needs at least one signal")
        found[spec["name"]] = _protocol(spec, key, file)
    file.stop_if_wrong()
    return tuple(found.values())


def _protocol(spec: dict[str, Any], key: KeyPath, file: DesignFile) -> UserProtocol:
    protocol = make_protocol(spec["name"], [_signal(name, signal) for name, signal in spec["signals"].items()])
    bindings = []
    for index, given in enumerate(spec.get("bindings") or ()):
        here: KeyPath = (*key, "bindings", index)
        for signal in given["ports"].keys() - protocol.signals.keys():
            message = f"{protocol.name} has no signal {signal}; it has {', '.join(protocol.signals)}"
            file.report((*here, "ports", signal), "unknown_signal", message)
        lacking = [s.name for s in protocol.signals.values() if s.required and s.name not in given["ports"]]
        if lacking:
            message = f"{', '.join(lacking)} must be given too ({protocol.name} requires it)"
            file.report((*here, "ports"), "missing_key", message)
        mark = locate(file.given, here)
        where = f"{file.source}:{mark.line}:{mark.column}"
        ports = MappingProxyType(given["ports"])
        clock, reset = given.get("clock", ""), given.get("reset", "")
        bindings.append(Binding(given["module"], given["name"], Mode(given["mode"]), ports, clock, reset, where))
    return UserProtocol(protocol, tuple(bindings))


def _signal(name: str, spec: dict[str, Any]) -> Signal:
    spellings = tuple(spelling.lower() for spelling in spec.get("names", ()))
    one = spec.get("width") == 1
    return Signal(name, PortDirection(spec["direction"]), spec.get("required", True), one, spellings)
