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
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import yaml

from cm.design.hdl.buses import Protocol, Signal, make_protocol
from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import Mode, PortDirection
from cm.design.hdl.yaml_nodes import Node, compose

_RESERVED = ("axi4", "axi3", "axi4lite", "axis", "aximm", "clock", "reset", "interrupt")
_DIRECTIONS = {"in": PortDirection.IN, "out": PortDirection.OUT, "inout": PortDirection.INOUT}
_MODES = {"master": Mode.MASTER, "slave": Mode.SLAVE}


@dataclass(frozen=True, slots=True)
class Binding:
    """One interface declared port by port; `where` is "file:line" for messages."""

    module: str
    name: str
    mode: Mode
    ports: Mapping[str, str]
    clock: str = ""
    reset: str = ""
    where: str = ""


@dataclass(frozen=True, slots=True)
class UserProtocol:
    """A user's protocol, and the interfaces that are bound to it explicitly."""

    protocol: Protocol
    bindings: tuple[Binding, ...] = ()

    @property
    def name(self) -> str:
        """The protocol's name."""
        return self.protocol.name


def load_protocols(path: str | Path) -> tuple[UserProtocol, ...]:
    """Read a protocols file. Raises `HdlError` with file, line and what would be right."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise HdlError(f"{path}: cannot be read: {error}") from error
    return parse_protocols(text, str(path))


def parse_protocols(text: str, name: str = "protocols.yaml") -> tuple[UserProtocol, ...]:
    """Do as `load_protocols`, for text; `name` is used in messages."""
    try:
        root = compose(text, name)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise HdlError(f"{name}: not YAML: {' '.join(str(error).split())}") from error
    if root is None:
        raise HdlError(f"{name}: the file is empty; it needs a list `protocols:`")
    top = root.mapping(("protocols",), ("protocols",))
    found = [_protocol(node) for node in top["protocols"].sequence()]
    names = [protocol.name for protocol in found]
    for index, protocol in enumerate(names):
        if protocol in names[:index]:
            raise top["protocols"].sequence()[index].error(f"the protocol {protocol} is defined twice")
    return tuple(found)


def _protocol(node: Node) -> UserProtocol:
    keys = node.mapping(("name", "signals", "bindings", "doc"), ("name", "signals"))
    name = keys["name"].identifier()
    if name.lower() in _RESERVED:
        raise keys["name"].error(f"{name} is built in: choose another name")
    signals = [_signal(key, value) for key, value in keys["signals"].items()]
    if not signals:
        raise keys["signals"].error("a protocol needs at least one signal")
    protocol = make_protocol(name, signals)
    bindings = [_binding(item, protocol) for item in keys["bindings"].sequence()] if "bindings" in keys else []
    return UserProtocol(protocol, tuple(bindings))


def _signal(key: Node, value: Node) -> Signal:
    name = key.identifier()
    if value.is_scalar:
        return Signal(name, value.choice(_DIRECTIONS), required=True)
    keys = value.mapping(("direction", "width", "required", "names", "doc"), ("direction",))
    width = keys["width"].integer(1, 1 << 16) if "width" in keys else None
    return Signal(
        name,
        keys["direction"].choice(_DIRECTIONS),
        required=keys["required"].boolean() if "required" in keys else True,
        handshake=width == 1,
        spellings=tuple(item.identifier().lower() for item in keys["names"].sequence()) if "names" in keys else (),
        width=width,
    )


def _binding(node: Node, protocol: Protocol) -> Binding:
    keys = node.mapping(("module", "name", "mode", "ports", "clock", "reset"), ("module", "name", "mode", "ports"))
    ports = {}
    for key, value in keys["ports"].items():
        if key.text() not in protocol.signals:
            raise key.error(f"{protocol.name} has no signal {key.text()}; it has {', '.join(protocol.signals)}")
        ports[key.text()] = value.text()
    lacking = [s.name for s in protocol.signals.values() if s.required and s.name not in ports]
    if lacking:
        raise keys["ports"].error(f"{', '.join(lacking)} must be given too ({protocol.name} requires it)")
    return Binding(
        keys["module"].text(),
        keys["name"].identifier(),
        keys["mode"].choice(_MODES),
        MappingProxyType(ports),
        keys["clock"].text() if "clock" in keys else "",
        keys["reset"].text() if "reset" in keys else "",
        node.where,
    )
