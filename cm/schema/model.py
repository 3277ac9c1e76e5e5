# SPDX-License-Identifier: Apache-2.0
"""The runtime schema as frozen data: what `cm.schema.load` returns and the manager works on.

Nothing here knows YAML, files of the host or devices. Mappings are read-only
(`types.MappingProxyType` or `frozendict`-like); order is that of the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from cm.field_access import KINDS, Kind, Rest, rest_of
from cm.frozen import dataclass, field
from cm.schema.pictures import CameraInfo

_K = TypeVar("_K")
_V = TypeVar("_V")

ITEM_BYTES: Mapping[str, int] = MappingProxyType(
    {
        **dict.fromkeys(("bool", "int8", "uint8"), 1),
        **dict.fromkeys(("int16", "uint16", "float16"), 2),
        **dict.fromkeys(("int32", "uint32", "float32"), 4),
        **dict.fromkeys(("int64", "uint64", "float64", "complex64"), 8),
        "complex128": 16,
    }
)  # of each dtype


def _empty() -> Mapping[Any, Any]:
    return MappingProxyType({})


class ConfigType(str, Enum):
    """`partial`: modules are loaded into regions of a running static design; `full`: one whole image."""

    PARTIAL = "partial"
    FULL = "full"


class Access(str, Enum):
    """Access of a register: read-write, read-only, write-only, write-one-to-clear."""

    RW = "rw"
    RO = "ro"
    WO = "wo"
    W1C = "w1c"


class LoaderKind(str, Enum):
    """How a region's bitstream reaches the device."""

    ICAP = "icap"
    FPGA_MANAGER = "fpga_manager"
    OVERLAY = "overlay"
    AUTO = "auto"  # the first that the board has, of ICAP and fpga_manager; replaced when a change is planned


class Direction(str, Enum):
    """Direction of a DMA channel, as in the AXI DMA's data sheet (PG021)."""

    MM2S = "mm2s"
    S2MM = "s2mm"


class FieldAccess(str, Enum):
    """What bits do when their register is read or written, by UVM's names; `cm.field_access` has what follows."""

    RW = "rw"
    RO = "ro"
    WO = "wo"
    RC = "rc"  # read-only, and reading clears
    RS = "rs"  # read-only, and reading sets
    WRC = "wrc"  # read-write, and reading clears
    WRS = "wrs"  # read-write, and reading sets
    WC = "wc"  # any write clears
    WS = "ws"  # any write sets
    W1C = "w1c"  # a written 1 clears, and so on
    W1S = "w1s"  # also of bits that the hardware clears by itself
    W1T = "w1t"  # toggles
    W0C = "w0c"  # a written 0 clears, and so on
    W0S = "w0s"
    W0T = "w0t"
    W1SRC = "w1src"  # a written 1 sets, reading clears, and so on
    W1CRS = "w1crs"
    W0SRC = "w0src"
    W0CRS = "w0crs"
    WSRC = "wsrc"
    WCRS = "wcrs"

    @property
    def kind(self) -> Kind:
        """What these bits do."""
        return KINDS[self.value]


@dataclass(frozen=True, slots=True)
class BitField:
    """A named run of bits in a register."""

    name: str
    lsb: int
    width: int
    doc: str = ""
    values: Mapping[str, int] = field(default_factory=_empty)  # names of values, for people
    access: FieldAccess | None = None  # None: as the register

    @property
    def mask(self) -> int:
        """The field's bits in place."""
        return ((1 << self.width) - 1) << self.lsb


@dataclass(frozen=True, slots=True)
class Register:
    """A named register: `base_address + offset` is its physical address."""

    name: str
    base_address: int
    offset: int
    width: int = 32  # 8, 16, 32 or 64 bits
    access: Access = Access.RW
    default: int | None = None  # written when the mode is entered; None: left alone
    reset: int | None = None  # value after the module was loaded, where the designer knows it
    minimum: int | None = None
    maximum: int | None = None
    fields: Mapping[str, BitField] = field(default_factory=_empty)
    region: str | None = None  # region whose module answers; None: the static part
    volatile: bool = False  # may change by itself: never verified, always read
    doc: str = ""
    type: str = "uint"  # of the bits: uint, int, float32 or float64
    fraction: int = 0  # bits of a uint or int behind the binary point

    @property
    def address(self) -> int:
        """Physical address."""
        return self.base_address + self.offset

    def access_of(self, field: BitField) -> FieldAccess:
        """What a field's bits do: its own access, or else the register's."""
        return field.access or FieldAccess(self.access.value)

    def rest(self, mask: int) -> Rest:
        """What a write of the bits in `mask` writes to the others."""
        fields = [(f.name, f.mask, self.access_of(f).value) for f in self.fields.values()]
        return rest_of((self.access.value, self.width), fields, mask)

    @property
    def read_changes(self) -> bool:
        """Whether reading it clears or sets a field."""
        return any(self.access_of(f).kind.read_changes for f in self.fields.values())

    @property
    def keeps(self) -> bool:
        """Whether it reads as what was last written, as far as is known."""
        plain = self.access is Access.RW and not self.volatile
        return plain and (not self.fields or all(f.access in (None, FieldAccess.RW) for f in self.fields.values()))


@dataclass(frozen=True, slots=True)
class Memory:
    """A named memory behind an AXI or AXI-Lite window: `size` bytes at `base_address + offset`, both multiples of 4."""

    name: str
    base_address: int
    size: int
    offset: int = 0
    access: Access = Access.RW  # W1C is for registers only
    dtype: str = "uint32"  # a numpy dtype name; elements are little-endian
    shape: tuple[int, ...] | None = None  # of the whole; None: one axis of as many elements as fit
    region: str | None = None  # region whose module answers; None: the static part
    doc: str = ""

    @property
    def address(self) -> int:
        """Physical address of the first byte."""
        return self.base_address + self.offset

    @property
    def end(self) -> int:
        """Physical address behind the last byte."""
        return self.address + self.size

    @property
    def item(self) -> int:
        """Bytes of one element."""
        return ITEM_BYTES[self.dtype]


@dataclass(frozen=True, slots=True)
class Block:
    """An IP of the static part: `size` bytes at `base_address`, where the processor sees any.

    Registers and memories in there are its own; their names begin with `prefix`. `peers`: the blocks and streams that
    its stream outputs lead to.
    """

    name: str
    base_address: int = 0
    size: int = 0  # 0: it has no window
    vlnv: str = ""
    prefix: str = ""
    interrupts: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    peers: tuple[str, ...] = ()
    doc: str = ""


@dataclass(frozen=True, slots=True)
class IsolationStep:
    """One access of a sequence that isolates a region, or connects it again.

    A register at `offset` from the decoupler's is written `cut` or `couple`, in the bits of `mask`, and read back
    if it can be (`verify`); with `poll` it is read until it has that value, for `timeout` seconds.
    """

    offset: int
    cut: int
    couple: int
    mask: int | None = None  # None: all bits
    poll: bool = False
    verify: bool = True
    timeout: float = 1.0


@dataclass(frozen=True, slots=True)
class GpioLine:
    """A line of a GPIO chip of the kernel; `chip` is its label (``zynq_gpio``) or its name (``gpiochip0``)."""

    chip: str
    line: int | str  # its offset in the chip, or its name


@dataclass(frozen=True, slots=True)
class Decoupler:
    """What isolates a region while it is loaded.

    A bit (PG375 DFX decoupler, or an own register), a `sequence`, or a line that the processor drives (`gpio`).
    """

    base_address: int = 0
    offset: int = 0
    bit: int = 0
    width: int = 32
    active_high: bool = True
    sequence: tuple[IsolationStep, ...] = ()  # in place of the bit
    gpio: GpioLine | None = None  # in place of registers

    @property
    def size(self) -> int:
        """Bytes of registers that belong to it; 0 for a GPIO line."""
        if self.gpio is not None:
            return 0
        return max((step.offset for step in self.sequence), default=0) + self.width // 8


@dataclass(frozen=True, slots=True)
class FrameRange:
    """Configuration frames that a region owns, by FAR fields; inclusive."""

    block_type: int
    row: int
    column_first: int
    column_last: int


@dataclass(frozen=True, slots=True)
class Identity:
    """Register by which a loaded module says what it is, and the value it must read."""

    base_address: int
    offset: int
    width: int = 32

    @property
    def size(self) -> int:
        """Bytes."""
        return self.width // 8


@dataclass(frozen=True, slots=True)
class StaticIdentity:
    """Which static design the modules were made with, and where a board says which one it holds.

    None means not known. `identity` is what the register at `base_address` + `offset` reads; `user_id` the USERID in
    the headers of the bitstreams; `uid` a name that another manager gave.
    """

    identity: int | None = None
    base_address: int | None = None
    offset: int = 0
    width: int = 32
    user_id: int | None = None
    uid: str | None = None


@dataclass(frozen=True, slots=True)
class Region:
    """A partially reconfigurable region (PRR)."""

    name: str
    loader: LoaderKind = LoaderKind.ICAP
    loader_name: str | None = None  # which ICAP or fpga_manager, where there are several
    decoupler: Decoupler | None = None
    footprint: tuple[FrameRange, ...] = ()
    identity: Identity | None = None
    timeout: float | None = None  # seconds for one load; None: from size and throughput
    allow_encrypted: bool = False


@dataclass(frozen=True, slots=True)
class Module:
    """A reconfigurable module (RM): a circuit that fits one region."""

    name: str
    region: str
    bitstream: Path | None = None  # as written; None: found by the module's name
    sha256: str | None = None
    identity: int | None = None  # value of the region's identity register
    model: str | None = None  # behaviour on the simulated board; None: the module's name
    registers: Mapping[str, Register] = field(default_factory=_empty)
    doc: str = ""
    memories: Mapping[str, Memory] = field(default_factory=_empty)


@dataclass(frozen=True, slots=True)
class Overlay:
    """A device-tree overlay: `name` in configfs, `file` the .dtbo (None: `<name>.dtbo`)."""

    name: str
    file: Path | None = None


@dataclass(frozen=True, slots=True)
class Interrupt:
    """A named interrupt: the line of the UIO device at `base_address` or called `uio`.

    Several names share one line when `status` names the register (and `bit` the bit) that tells
    them apart; `acknowledge` says that the bit is cleared by writing 1 to it.
    """

    name: str
    base_address: int | None = None
    uio: str | None = None
    status: str | None = None
    bit: int | None = None
    acknowledge: bool = False
    doc: str = ""


@dataclass(frozen=True, slots=True)
class Stream:
    """A named data stream over a DMA channel; `shape` and `dtype` describe one frame."""

    name: str
    channel: str
    direction: Direction
    shape: tuple[int, ...] | None = None  # None: flat bytes of the actual length
    dtype: str = "uint8"  # a numpy dtype name
    slots: int = 8
    region: str | None = None  # region whose module it passes through
    cyclic: bool = False
    rate: float | None = None  # frames per second that the source gives, for people and the simulator
    doc: str = ""
    backpressure: bool = False  # readers lose nothing: the hardware waits for the slowest
    stride: int | None = None  # bytes from line to line in memory (VDMA); None: lines follow each other
    slot_bytes: int | None = None  # of a packet at most, where there is no shape; None: 1 MiB, or what the channel says
    max_length: int | None = None  # bytes of one transfer at most, as the engine was built; None: what the channel says
    limit: float | None = None  # frames handed on per second at most; None: all
    format: str | None = None  # of pixels in memory, a key of `pictures.FORMATS`: clients read and write RGB
    encoding: str | None = None  # of a pixel, by ROS's names; None: what shape and dtype say
    frame_id: str | None = None  # the coordinates that the data are in; None: the stream's name
    camera_info: CameraInfo | None = None


@dataclass(frozen=True, slots=True)
class Clock:
    """A PL clock and the rate a configuration needs, in Hz."""

    name: str
    rate: int
    doc: str = ""
    tolerance: float = 1.0  # percent by which the rate may be off


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode of the system: the modules, overlays and register values that make it."""

    name: str
    modules: tuple[str, ...] = ()
    registers: Mapping[str, Register] = field(default_factory=_empty)
    overlays: tuple[Overlay, ...] = ()
    streams: Mapping[str, Stream] = field(default_factory=_empty)  # complete, config's streams merged in
    doc: str = ""
    memories: Mapping[str, Memory] = field(default_factory=_empty)
    run: str | None = None  # "once" or "continuous": modules with a field `start` are started when all is set


@dataclass(frozen=True, slots=True)
class Config:
    """A configuration: a hardware structure with its data interfaces and its modes.

    `registers` are those of the static part, valid in every mode. A register's name is unique
    within what is visible in one mode. `regions` is never empty for a partial configuration:
    if the file names none, there is one, called ``prr0``.
    """

    name: str
    type: ConfigType = ConfigType.PARTIAL
    device: str | None = None  # e.g. "xc7z020"; None: any
    idcode: int | None = None  # of the bitstreams, for a device that `cm.formats.bitstream` does not know
    bitstream: Path | None = None  # static image of a full configuration
    sha256: str | None = None
    loader: LoaderKind = LoaderKind.FPGA_MANAGER  # of the static image; never AUTO
    timeout: float | None = None  # seconds for loading it
    allow_encrypted: bool = False  # of the static image
    default_mode: str | None = None  # None: "default" if there is one, else the first
    regions: Mapping[str, Region] = field(default_factory=_empty)
    modules: Mapping[str, Module] = field(default_factory=_empty)
    modes: Mapping[str, Mode] = field(default_factory=_empty)
    registers: Mapping[str, Register] = field(default_factory=_empty)
    overlays: tuple[Overlay, ...] = ()  # applied with the configuration, under every mode
    streams: Mapping[str, Stream] = field(default_factory=_empty)
    interrupts: Mapping[str, Interrupt] = field(default_factory=_empty)
    clocks: Mapping[str, Clock] = field(default_factory=_empty)
    doc: str = ""
    source: Path | None = None  # file it was read from
    sha256_source: str = ""  # of that file's bytes
    memories: Mapping[str, Memory] = field(default_factory=_empty)  # of the static part, as `registers`
    blocks: Mapping[str, Block] = field(default_factory=_empty)
    static: StaticIdentity | None = None  # None: not known which static design the modules belong to

    def first_mode(self) -> str:
        """The mode to enter when none is named."""
        if self.default_mode is not None:
            return self.default_mode
        return "default" if "default" in self.modes else next(iter(self.modes))

    def streams_in(self, mode: str | None, held: Mapping[str, str | None]) -> Mapping[str, Stream]:
        """The streams of `mode`, where regions hold what `held` says; none without a mode of this name.

        A region that the mode does not name keeps its module, and so its streams keep what the modes of that
        module say of them, if they all say the same and this mode says nothing.
        """
        there = self.modes.get(mode) if mode is not None else None
        if there is None:
            return _empty()
        named = {self.modules[module].region for module in there.modules}
        found = dict(there.streams)
        for name, stream in there.streams.items():
            if stream.region is not None and stream.region not in named and stream == self.streams.get(name):
                module = held.get(stream.region)
                others = {m.streams[name] for m in self.modes.values() if module in m.modules and name in m.streams}
                found[name] = others.pop() if len(others) == 1 else stream
        return found

    def visible_registers(self, mode: str | None) -> dict[str, Register]:
        """Registers that can be named in `mode`: the static part's, its modules' and its own."""
        found = dict(self.registers)
        if mode is not None:
            for module in self.modes[mode].modules:
                found.update(self.modules[module].registers)
            found.update(self.modes[mode].registers)
        return found

    def registers_of(self, region: str) -> frozenset[str]:
        """Names of a region's registers, in all modes."""
        visible = [self.visible_registers(mode) for mode in self.modes]
        return frozenset([name for registers in visible for name, r in registers.items() if r.region == region])

    def controls(self, mode: str) -> Iterator[tuple[Register, int]]:
        """What `run` of a mode starts: the registers with a field `start`, and what is written to each."""
        said = self.modes[mode]
        for register in [r for name in said.modules for r in self.modules[name].registers.values()] if said.run else ():
            wanted = ("start",) if said.run == "once" else ("start", "auto_restart")
            if all(word in register.fields for word in wanted):
                yield register, sum(register.fields[word].mask for word in wanted)

    def visible_memories(self, mode: str | None) -> dict[str, Memory]:
        """Memories that can be named in `mode`, as `visible_registers`. No stream of any mode has their names."""
        found = dict(self.memories)
        if mode is not None:
            for module in self.modes[mode].modules:
                found.update(self.modules[module].memories)
            found.update(self.modes[mode].memories)
        return found
