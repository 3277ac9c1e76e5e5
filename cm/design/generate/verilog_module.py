# SPDX-License-Identifier: Apache-2.0
"""A Verilog module made of instances and assignments, as data; `templates/module.v.j2` writes it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cm.design.hdl.model import PortDirection

_KEYWORD = {PortDirection.IN: "input  wire", PortDirection.OUT: "output wire", PortDirection.INOUT: "inout  wire"}


def vector(width: int) -> str:
    """The range of a declaration: empty for one bit."""
    return "" if width == 1 else f"[{width - 1}:0]"


def zeros(width: int) -> str:
    """A constant of `width` zeros."""
    return "1'b0" if width == 1 else f"{{{width}{{1'b0}}}}"


def ones(width: int) -> str:
    """A constant of `width` ones."""
    return "1'b1" if width == 1 else f"{{{width}{{1'b1}}}}"


def concat(parts: Iterable[str]) -> str:
    """A concatenation, or its only part."""
    listed = list(parts)
    return listed[0] if len(listed) == 1 else f"{{{', '.join(listed)}}}"


def low_bits(name: str, have: int, want: int) -> str:
    """`want` bits of a signal that has `have`: its low ones, or padded with zeros."""
    if have == want:
        return name
    if have > want:
        return f"{name}[{want - 1}:0]" if want > 1 else f"{name}[0]"
    return f"{{{zeros(want - have)}, {name}}}"


@dataclass(frozen=True, slots=True)
class Signal:
    """A wire or, with a direction, a port."""

    name: str
    width: int = 1
    direction: PortDirection | None = None
    indexed: bool = False  # a vector even if it has only one bit

    @property
    def declaration(self) -> str:
        """As in a port list."""
        keyword = _KEYWORD[self.direction] if self.direction else "wire"
        bits = "[0:0]" if self.indexed and self.width == 1 else vector(self.width)
        return " ".join(part for part in (keyword, bits, self.name) if part)


@dataclass(frozen=True, slots=True)
class Instance:
    """An instance; a connection of None leaves the pin open."""

    module: str
    name: str
    parameters: Mapping[str, object]
    connections: Mapping[str, str | None]
    comment: str = ""


@dataclass(slots=True)
class Netlist:
    """A module while it is put together."""

    name: str
    doc: str = ""
    black_box: bool = False
    ports: list[Signal] = field(default_factory=list)
    wires: list[Signal] = field(default_factory=list)
    assigns: list[tuple[str, str]] = field(default_factory=list)
    instances: list[Instance] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)

    def port(self, name: str, direction: PortDirection, width: int = 1) -> str:
        """Add a port; returns its name."""
        self.ports.append(Signal(name, width, direction))
        return name

    def wire(self, name: str, width: int = 1, indexed: bool = False) -> str:
        """Add a wire; returns its name."""
        self.wires.append(Signal(name, width, None, indexed))
        return name

    @property
    def open_pins(self) -> bool:
        """Whether an instance leaves a pin open."""
        return any(None in instance.connections.values() for instance in self.instances)

    def assign(self, left: str, right: str) -> None:
        """Add a continuous assignment."""
        self.assigns.append((left, right))

    def instance(
        self,
        module: str,
        name: str,
        connections: Mapping[str, str | None],
        parameters: Mapping[str, object] | None = None,
        comment: str = "",
    ) -> None:
        """Add an instance."""
        self.instances.append(Instance(module, name, parameters or {}, connections, comment))
