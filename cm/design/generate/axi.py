# SPDX-License-Identifier: Apache-2.0
"""Signals of AXI interfaces: which exist on an interface, who drives them, how they are packed.

Names and directions: AMBA AXI and ACE protocol specification (IHI 0022), AMBA AXI-Stream (IHI 0051).
"""

from __future__ import annotations

from dataclasses import dataclass

from cm.design.errors import BuildError
from cm.design.hdl.model import Interface

ADDRESS = ("ADDR", "SIZE", "BURST", "LOCK", "CACHE", "PROT", "QOS", "REGION")
STREAM = ("TDATA", "TKEEP", "TSTRB", "TID", "TDEST", "TUSER")
_FROM_SLAVE = ("AWREADY", "WREADY", "BVALID", "BRESP", "BID", "BUSER", "ARREADY", "RVALID", "RDATA", "RRESP", "RLAST")
FROM_SLAVE = frozenset((*_FROM_SLAVE, "RID", "RUSER", "TREADY"))


@dataclass(frozen=True, slots=True)
class Field:
    """A signal of an interface: its logical name, the port at the boundary and its bits."""

    logical: str
    port: str
    width: int


def fields(interface: Interface, names: tuple[str, ...], prefix: str = "") -> list[Field]:
    """The signals of `names` that `interface` has, in that order."""
    found = []
    for name in names:
        logical = prefix + name
        if logical in interface.ports:
            found.append(Field(logical, interface.ports[logical], width_of(interface, logical)))
    return found


def width_of(interface: Interface, logical: str) -> int:
    """Bits of a signal; BuildError where extraction could not tell."""
    width = interface.widths.get(logical)
    if not width:
        raise BuildError(f"{interface.name}: the width of {logical} could not be evaluated")
    return width
