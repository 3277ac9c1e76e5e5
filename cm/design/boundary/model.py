# SPDX-License-Identifier: Apache-2.0
"""A region's common boundary as frozen data, and how each module is fitted to it.

Directions are those of the module in the region: `OUT` is driven by the module. Boundary port names
are made of interface and logical signal (`s_axi_awaddr`, `m_axis_tdata`), in lower case.
"""

from __future__ import annotations

from enum import Enum

from cm.design.hdl.model import Interface, PortDirection
from cm.frozen import dataclass, field


class Role(str, Enum):
    """The purpose of a boundary port."""

    CLOCK = "clock"
    RESET = "reset"  # active low at the boundary; a wrapper inverts for modules that need it
    BUS = "bus"
    INTERRUPT = "interrupt"
    SIGNAL = "signal"  # a leftover port that modules share by name


class Fit(str, Enum):
    """How one boundary port and one module port meet in the wrapper."""

    CONNECT = "connect"  # same width
    INVERT = "invert"  # a reset of the other polarity
    EXTEND = "extend"  # driven side is wider: the missing high bits are 0
    TRUNCATE = "truncate"  # driven side is narrower: the high bits are dropped (known to be 0 or without meaning)
    TIE = "tie"  # undriven: `value` on all bits
    OPEN = "open"  # unread; an input of the module: unconnected, it has a default of its own


@dataclass(frozen=True, slots=True)
class BoundaryPort:
    """One port of the region, seen from the module: `idle` is what an absent module's output must read (0 or 1)."""

    name: str
    direction: PortDirection
    width: int
    role: Role
    interface: str = ""
    logical: str = ""
    idle: int = 0
    left: str = ""  # of a signal: why it belongs to nothing


@dataclass(frozen=True, slots=True)
class Connection:
    """One assignment of a wrapper. `boundary` or `module` is empty where that side has no such port.

    OUT, `EXTEND`: boundary = {0, module}; IN, `TRUNCATE`: module = boundary[module_width-1:0];
    `TIE`: `value` on the side that exists; `OPEN`: the side that exists is left unread.
    """

    boundary: str
    module: str
    direction: PortDirection
    fit: Fit
    boundary_width: int = 0
    module_width: int = 0
    value: int = 0  # 0 or 1 for all bits of a TIE
    note: str = ""


@dataclass(frozen=True, slots=True)
class Adaptation:
    """How one module is fitted; `refused` says why it cannot be, one sentence each (then it must not be built)."""

    module: str
    connections: tuple[Connection, ...] = ()
    notes: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """The module can be wrapped."""
        return not self.refused


@dataclass(frozen=True, slots=True)
class Boundary:
    """The union of the interfaces of a region's modules, widths reconciled.

    `interfaces` have the boundary's own port names in `ports`; clock and reset are boundary ports.
    """

    ports: tuple[BoundaryPort, ...] = ()
    interfaces: tuple[Interface, ...] = ()
    adaptations: tuple[Adaptation, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Every module can be wrapped."""
        return all(adaptation.ok for adaptation in self.adaptations)

    def adaptation(self, module: str) -> Adaptation:
        """The adaptation of that module; KeyError if there is none."""
        for adaptation in self.adaptations:
            if adaptation.module == module:
                return adaptation
        raise KeyError(module)
