# SPDX-License-Identifier: Apache-2.0
"""Signals of AXI interfaces: which exist on an interface, who drives them, how they are packed.

Names and directions: AMBA AXI and ACE protocol specification (IHI 0022), AMBA AXI-Stream (IHI 0051).

Signals of a clock's AXI4-Lite interconnect, and which of them each window's slave uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cm.design.errors import BuildError
from cm.design.generate.verilog_module import concat
from cm.design.hdl.model import Interface, PortDirection
from cm.design.plan.addresses import Window
from cm.design.plan.system import Domain

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


def id_width(interface: Interface) -> int:
    """Bits of a slave's IDs, at least one."""
    return max(interface.widths.get(name) or 1 for name in ("AWID", "ARID"))


IN, OUT = PortDirection.IN, PortDirection.OUT

# name, direction at the static part, bits
LITE = (
    ("awaddr", IN, 32),
    ("awprot", IN, 3),
    ("awvalid", IN, 1),
    ("awready", OUT, 1),
    ("wdata", IN, 32),
    ("wstrb", IN, 4),
    ("wvalid", IN, 1),
    ("wready", OUT, 1),
    ("bresp", OUT, 2),
    ("bvalid", OUT, 1),
    ("bready", IN, 1),
    ("araddr", IN, 32),
    ("arprot", IN, 3),
    ("arvalid", IN, 1),
    ("arready", OUT, 1),
    ("rdata", OUT, 32),
    ("rresp", OUT, 2),
    ("rvalid", OUT, 1),
    ("rready", IN, 1),
)
PER_SLAVE = {"bresp": 2, "rresp": 2, "rdata": 32}
SHARED = ("awaddr", "awprot", "wdata", "wstrb", "araddr", "arprot")


def slave_port(domain: Domain, window: str, signal: str) -> str:
    """The interconnect's signal for a window: the shared one, or that slave's share."""
    index = [entry.name for entry in domain.windows].index(window)
    name = f"{domain.clock}_{signal}"
    if signal in SHARED:
        return name
    width = PER_SLAVE.get(signal, 1)
    if len(domain.windows) == 1:
        return name
    return f"{name}[{index}]" if width == 1 else f"{name}[{index * width}+:{width}]"


def slave_pins(domain: Domain, window: str) -> dict[str, str | None]:
    """The pins of a window's slave, which has no use for AxPROT."""
    names = (signal for signal, _, _ in LITE if signal not in ("awprot", "arprot"))
    return {f"s_{signal}": slave_port(domain, window, signal) for signal in names}


def decoded(windows: Sequence[Window]) -> dict[str, object]:
    """The parameters of an interconnect that has these windows behind it."""
    return {
        "COUNT": len(windows),
        "ADDR_WIDTH": 32,
        "BASE": concat(f"32'h{window.base:08X}" for window in reversed(windows)),
        "MASK": concat(f"32'h{0xFFFF_FFFF & ~(window.size - 1):08X}" for window in reversed(windows)),
    }
