# SPDX-License-Identifier: Apache-2.0
"""A block design as frozen data, in Vivado's own terms."""

from __future__ import annotations

from collections.abc import Mapping

from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class RegisterField:
    """A field of a register; `access` as Vivado writes it (``read-only``, ``read-write``, …) or empty."""

    name: str
    lsb: int
    width: int
    access: str = ""
    one_to_clear: bool = False
    doc: str = ""


@dataclass(frozen=True, slots=True)
class RegisterInfo:
    """A register that an IP describes: `offset` bytes from its address block, `size` bits."""

    name: str
    offset: int
    size: int
    access: str = ""
    reset: int | None = None
    fields: tuple[RegisterField, ...] = ()
    doc: str = ""


@dataclass(frozen=True, slots=True)
class ConnectedPort:
    """The other end of a port: an instance and its port."""

    instance: str
    port: str


@dataclass(frozen=True, slots=True)
class InstancePort:
    """A port: `direction` I, O or IO; `kind` is SIGIS (``INTERRUPT``, ``clk``, …); `width` in bits, `rate` in Hz."""

    name: str
    direction: str
    kind: str
    signal: str
    width: int
    connections: tuple[ConnectedPort, ...]
    rate: int = 0


@dataclass(frozen=True, slots=True)
class BusInterface:
    """A bus interface: `type` MASTER, SLAVE, INITIATOR or TARGET; `bus` the net it is on."""

    name: str
    type: str
    bus: str
    vlnv: str


@dataclass(frozen=True, slots=True)
class MemoryRange:
    """Addresses of a slave as one master sees it; `high` is the last byte's."""

    instance: str
    interface: str
    block: str
    base: int
    high: int
    kind: str  # REGISTER or MEMORY
    master: str  # the master's interface, e.g. M_AXI_GP0

    @property
    def size(self) -> int:
        """Bytes."""
        return self.high - self.base + 1


@dataclass(frozen=True, slots=True)
class ModuleInstance:
    """An IP in the design. `region`: it is a reconfigurable block design container or module (RBD)."""

    instance: str
    path: str
    type: str  # e.g. axi_gpio
    vlnv: str
    region: bool
    parameters: Mapping[str, str]
    ports: Mapping[str, InstancePort]
    interfaces: tuple[BusInterface, ...]
    registers: Mapping[str, tuple[RegisterInfo, ...]]  # by the interface of the address block
    ranges: tuple[MemoryRange, ...]  # what this instance can address

    @property
    def name(self) -> str:
        """The last part of the path: the instance's own name in its hierarchy."""
        return self.path.rsplit("/", 1)[-1]


@dataclass(frozen=True, slots=True)
class Hwh:
    """A whole file: `device` without package, e.g. ``7z020``."""

    design: str
    arch: str
    device: str
    package: str
    vivado: str
    timestamp: str
    modules: Mapping[str, ModuleInstance]  # by instance
    external_ranges: tuple[MemoryRange, ...]  # through an external slave port: the only ones in a partial design's file
