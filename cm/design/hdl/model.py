# SPDX-License-Identifier: Apache-2.0
"""What is known of an HDL module, as frozen data: ports, bus interfaces, clocks, resets, interrupts.

Nothing here knows a parser. Names of ports are spelled as in the source; logical signal names
(`TDATA`, `AWADDR`) are upper case, as in Vivado's bus definitions (`xilinx.com:interface:aximm:1.0`,
`xilinx.com:interface:axis:1.0`). Mappings are read-only and keep the order of the source.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, TypeVar

from cm.frozen import dataclass, field

_Named = TypeVar("_Named", "Port", "Interface")


def _empty() -> Mapping[Any, Any]:
    return MappingProxyType({})


class Language(str, Enum):
    """What a module's description was read from."""

    VERILOG = "verilog"
    SYSTEMVERILOG = "systemverilog"
    VHDL = "vhdl"
    IPXACT = "ipxact"
    HLS = "hls"
    HWH = "hwh"


class PortDirection(str, Enum):
    """Direction as the module sees it; `UNKNOWN` for SystemVerilog interface ports, `ref`, and any other word."""

    IN = "in"
    OUT = "out"
    INOUT = "inout"
    UNKNOWN = "unknown"

    @classmethod
    def _missing_(cls, value: object) -> PortDirection:
        del value
        return cls.UNKNOWN


class Mode(str, Enum):
    """The module's role on a bus: who starts a transfer (AXI), who sends (AXI4-Stream, interrupts)."""

    MASTER = "master"
    SLAVE = "slave"
    MONITOR = "monitor"


class Polarity(str, Enum):
    """Level at which a reset is active."""

    LOW = "low"
    HIGH = "high"


class FoundBy(str, Enum):
    """How an interface was found: what the designer wrote takes precedence over what a name suggests."""

    ATTRIBUTE = "attribute"  # X_INTERFACE_INFO (UG994)
    NAME = "name"  # naming convention
    PROTOCOL_FILE = "protocol_file"  # the user's own protocols
    IPXACT = "ipxact"  # component.xml
    HWH = "hwh"


@dataclass(frozen=True, slots=True)
class Port:
    """One port; `width` in bits, None where it could not be evaluated (the module's problems say why)."""

    name: str
    direction: PortDirection
    width: int | None
    file: str = ""
    line: int = 0
    range: str = ""  # as in the source: "[DATA_WIDTH-1:0]", "(7 downto 0)"; empty for one bit
    type: str = ""  # as in the source: "wire", "logic", "std_logic_vector"
    flat: bool = True  # False: interface, struct, unpacked array or record, which cannot cross a boundary as it is
    attributes: Mapping[str, str] = field(default_factory=_empty)  # keys in lower case
    default: str = ""  # default expression of an input, so that it may stay open


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter or generic; `value` is None where it could not be evaluated (a type, a function call)."""

    name: str
    value: int | float | str | None
    text: str = ""  # default as in the source
    local: bool = False  # localparam: cannot be set by an instance


@dataclass(frozen=True, slots=True)
class Interface:
    """A bus interface: `ports` maps logical signal names to ports; `widths` has bits per logical signal."""

    name: str
    protocol: str  # axi4, axi3, axi4lite, axis, the name of a user protocol, or the VLNV's name (bram, fifo_write)
    mode: Mode
    ports: Mapping[str, str]
    clock: str | None = None
    reset: str | None = None
    reset_polarity: Polarity | None = None
    widths: Mapping[str, int | None] = field(default_factory=_empty)
    found_by: FoundBy = FoundBy.NAME
    vlnv: str = ""
    parameters: Mapping[str, str] = field(default_factory=_empty)  # X_INTERFACE_PARAMETER or IP-XACT; keys upper case

    def _width(self, *logical: str) -> int | None:
        return next((self.widths[name] for name in logical if name in self.widths), None)

    @property
    def data_width(self) -> int | None:
        """Bits of data per beat."""
        return self._width("TDATA", "WDATA", "RDATA")

    @property
    def addr_width(self) -> int | None:
        """Bits of address; the wider of both channels."""
        widths = [w for w in (self._width("AWADDR"), self._width("ARADDR")) if w]
        return max(widths, default=None)

    @property
    def id_width(self) -> int | None:
        """Bits of the transaction or stream ID; the wider of both directions."""
        widths = [w for w in (self._width("AWID"), self._width("ARID"), self._width("TID")) if w]
        return max(widths, default=None)

    @property
    def reads(self) -> bool:
        """A memory-mapped interface with read channels."""
        return "ARVALID" in self.ports

    @property
    def writes(self) -> bool:
        """A memory-mapped interface with write channels."""
        return "AWVALID" in self.ports


@dataclass(frozen=True, slots=True)
class ModuleClock:
    """A clock; `interfaces` are the names of those that run on it."""

    name: str
    port: str
    direction: PortDirection = PortDirection.IN
    frequency_hz: int | None = None
    interfaces: tuple[str, ...] = ()
    reset: str | None = None  # port of the associated reset
    resets: tuple[str, ...] = ()  # ports that an attribute associates


@dataclass(frozen=True, slots=True)
class Reset:
    """A reset; its polarity is None if neither attribute nor name tells it.

    `clock`: the port of the clock that it belongs to, and `why`; or `may_be`: those that it may belong to.
    """

    name: str
    port: str
    polarity: Polarity | None = None
    direction: PortDirection = PortDirection.IN
    clock: str | None = None
    why: str = ""
    may_be: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Stated:
    """What the build schema says of a module's clocks and resets; it goes before the HDL and before names.

    `clocks`: port → the interfaces on it; `resets`: port → its clock and its polarity, each None if not said;
    `streams`: which of those with valid, data and acknowledge are streams, by the names of their ports; None: not said.
    `interrupts`: the ports that are interrupts, and no others; None: not said.
    """

    clocks: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    resets: Mapping[str, tuple[str | None, Polarity | None]] = field(default_factory=lambda: MappingProxyType({}))
    streams: tuple[str, ...] | None = None
    interrupts: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class Interrupt:
    """An interrupt; mode MASTER: the module raises it. `sensitivity` as Vivado spells it (LEVEL_HIGH, EDGE_RISING)."""

    name: str
    port: str
    mode: Mode = Mode.MASTER
    width: int | None = 1
    sensitivity: str = ""


@dataclass(frozen=True, slots=True)
class PortUse:
    """What the sources do with a port, as far as they were found (`cm.design.hdl.usage`).

    `clock`: registers follow its edges; `reset`: the level at which registers get constants, None if none, or both;
    `clocks`: ports at whose edges it is used; `constant`: the one, perhaps a generic, that has its level; `interrupt`:
    it is at a pin of that name of an instance.
    """

    clock: bool = False
    reset: Polarity | None = None
    asynchronous: bool = False
    clocks: tuple[str, ...] = ()
    constant: str = ""
    interrupt: bool = False


@dataclass(frozen=True, slots=True)
class Leftover:
    """A port that was not assigned to anything, and why."""

    port: str
    reason: str


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that could not be determined or read.

    `fatal`: the module cannot be used in a region as it is; `breaks`: synthesis cannot succeed (a syntax error, a
    missing file or module).
    """

    message: str
    file: str = ""
    line: int = 0
    fatal: bool = False
    breaks: bool = False

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}: " if self.file and self.line else f"{self.file}: " if self.file else ""
        return f"{where}{self.message}"


@dataclass(frozen=True, slots=True)
class ModuleInfo:
    """A module (Verilog), entity (VHDL) or component (IP-XACT) with all that was found in it."""

    name: str
    file: str
    language: Language
    line: int = 0
    parameters: tuple[Parameter, ...] = ()
    ports: tuple[Port, ...] = ()
    interfaces: tuple[Interface, ...] = ()
    clocks: tuple[ModuleClock, ...] = ()
    resets: tuple[Reset, ...] = ()
    interrupts: tuple[Interrupt, ...] = ()
    leftovers: tuple[Leftover, ...] = ()
    problems: tuple[Problem, ...] = ()
    instantiates: tuple[str, ...] = ()  # names of the modules instantiated directly, in order, each once
    asked: tuple[str, ...] = ()  # what may be streams, and only a person knows (`Stated.streams`)

    def port(self, name: str) -> Port:
        """The port of that name; KeyError where there is none."""
        return _named(self.ports, name)

    def interface(self, name: str) -> Interface:
        """The interface of that name; KeyError where there is none."""
        return _named(self.interfaces, name)

    @property
    def usable(self) -> bool:
        """No problem is fatal: the module can be wrapped."""
        return not any(problem.fatal for problem in self.problems)


def _named(things: tuple[_Named, ...], name: str) -> _Named:
    for thing in things:
        if thing.name == name:
            return thing
    raise KeyError(name)


def unique(name: str, taken: Iterable[str]) -> str:
    """Return the name, with a number appended if it is taken."""
    taken = set(taken)
    number = 2
    result = name
    while result in taken:
        result = f"{name}_{number}"
        number += 1
    return result
