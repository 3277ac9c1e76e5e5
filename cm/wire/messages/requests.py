# SPDX-License-Identifier: Apache-2.0
"""What a client can ask of the configuration manager: one class for each intent.

Several of them share a topic and a message on the wire (`cm.wire.decode` tells them apart).
"""

from __future__ import annotations

from cm.frozen import KW_ONLY, dataclass, field
from cm.hashes import sha256

WHOLE = "*"  # all regions
LEASE_SECONDS = 30.0  # for which a lease is held if nobody says how long


@dataclass(frozen=True, slots=True)
class ReadStatus:
    """The current `cm.wire.messages.status.Status`; with its `clients`, or its `changes` and `writes`, if asked for."""

    clients: bool = False
    history: bool = False


@dataclass(frozen=True, slots=True)
class ReadConfig:
    """A configuration's description; of the loaded one if `config_name` is empty."""

    config_name: str = ""


@dataclass(frozen=True, slots=True)
class ListConfigs:
    """The names of all configurations that can be loaded."""


@dataclass(frozen=True, slots=True)
class PlanChange:
    """What going to a mode would do; to the configuration's default mode if `mode` is empty."""

    config_name: str = ""
    mode: str = ""
    unload: str = ""  # as of `ChangeMode`


@dataclass(frozen=True, slots=True)
class File:
    """A file that comes with a schema; `data` are its bytes, `sha256` (hex) is the hash that they must have."""

    name: str
    data: bytes | memoryview = field(repr=False)
    _: KW_ONLY
    sha256: str = ""
    upload: str = ""  # the id of an `Upload` that has the bytes

    def uploaded(self, name: str) -> File:
        """The same file, with its bytes sent before by uploads."""
        return File(self.name, b"", sha256=self.sha256 or sha256(self.data), upload=name)


@dataclass(frozen=True, slots=True)
class ChangeMode:
    """Go to a mode of a configuration; without names, of the loaded one, and to its default mode.

    `name_or_mode` carries the plain-text spelling of the paper's Listing 2, whose one word may be
    a mode, a module or a configuration; it is resolved against what is loaded. `no_wait`: reply when the change
    is accepted. `no_queue`: refuse rather than wait for a running change. `force`: load modules even if they are
    loaded already. `undoable`: a name under which the way back is kept until the next change; `undo`: go that way,
    to `config_name` and `mode` of before, with what registers and clocks had then. `unload`: go to no mode, but isolate
    this region of the loaded configuration, or `WHOLE` of it.
    """

    config_name: str = ""
    mode: str = ""
    _: KW_ONLY
    name_or_mode: str = ""
    no_wait: bool = False
    no_queue: bool = False
    force: bool = False
    lease: str = ""
    undoable: str = ""
    undo: str = ""
    unload: str = ""


@dataclass(frozen=True, slots=True)
class CancelChange:
    """End the running change before its next load; the board goes back to the mode before."""

    number: int | None = None  # the manager's own: only if that one runs


@dataclass(frozen=True, slots=True)
class Provision:
    """Store a configuration with its files, then go to it as `change` says (its `config_name` is the schema's)."""

    schema: str
    files: tuple[File, ...] = ()
    _: KW_ONLY
    change: ChangeMode | None = None
    lease: str = ""


@dataclass(frozen=True, slots=True)
class RemoveConfig:
    """Forget a configuration that a client sent, and its files."""

    config_name: str
    lease: str = ""


@dataclass(frozen=True, slots=True)
class ReadReg:
    """Values of registers or fields (``register.field``); of all readable ones if none is named."""

    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RegWrite:
    """One write; with `mask`, a read-modify-write of the bits set in it; `named`: a field's value by its name."""

    name: str
    value: int
    _: KW_ONLY
    mask: int | None = None
    named: str = ""


@dataclass(frozen=True, slots=True)
class WriteReg:
    """Several writes, all checked before the first is done, then done in order."""

    writes: tuple[RegWrite, ...]
    lease: str = ""


@dataclass(frozen=True, slots=True)
class DescribeData:
    """The settings and counters of a stream, or the description of a memory of that name."""

    name: str
    lease: str = ""


@dataclass(frozen=True, slots=True)
class ConfigureStream:
    """Change a stream; empty, zero or None leaves a property as it is.

    `rate`: frames handed on per second at most; infinity: all that come. `stride`: bytes from line to line.
    `enable`: start or stop it for all; `automatic`: it runs while a client uses it, as it does before any `enable`.
    `force`: even if it is in use.
    """

    stream: str
    shape: tuple[int, ...] = ()
    _: KW_ONLY
    dtype: str = ""
    slots: int = 0
    direction: str = ""
    rate: float = 0.0
    cyclic: bool | None = None
    enable: bool | None = None
    force: bool = False
    lease: str = ""
    backpressure: bool | None = None
    stride: int = 0
    automatic: bool = False


@dataclass(frozen=True, slots=True)
class DefineMemory:
    """Define a memory until the next change of configuration; `address` and `length` in bytes.

    `access` is rw if empty. `region`: "static" or a region's name; empty: the region of the registers and memories in
    the same window.
    """

    name: str
    address: int | None = None
    _: KW_ONLY
    length: int = 0
    shape: tuple[int, ...] = ()
    dtype: str = ""
    access: str = ""
    region: str = ""
    lease: str = ""


@dataclass(frozen=True, slots=True)
class ReadData:
    """The next frame of a readable stream, or `length` bytes (0: the rest) of a memory of that name."""

    stream: str = ""
    timeout: float = 0.0
    _: KW_ONLY
    offset: int = 0
    length: int = 0


@dataclass(frozen=True, slots=True)
class WriteData:
    """A frame for a writable stream, or bytes for a memory of that name, from `offset` on; `data` are its bytes."""

    stream: str
    data: bytes | memoryview = field(repr=False, default=b"")
    _: KW_ONLY
    lease: str = ""
    offset: int = 0
    upload: str = ""  # the id of an `Upload` that has the bytes
    format: str = ""  # of the pixels, if they are any: refused unless the stream's is this, or none


@dataclass(frozen=True, slots=True)
class Upload:
    """A part of data that is too long for one message: `data` from `offset` on, of `length` bytes in all."""

    id: str
    length: int = 0
    _: KW_ONLY
    offset: int = 0
    data: bytes | memoryview = field(repr=False, default=b"")
    discard: bool = False


@dataclass(frozen=True, slots=True)
class CheckRegion:
    """Compare a region's frames with what was loaded; with `repair`, write what is wrong anew, and compare again.

    `reload`: by loading the whole region again, also where its frames could be written one by one.
    """

    name: str
    repair: bool = False
    _: KW_ONLY
    reload: bool = False
    lease: str = ""


@dataclass(frozen=True, slots=True)
class MapRegion:
    """What was loaded into a region, column by column."""

    name: str


@dataclass(frozen=True, slots=True)
class ReadIrq:
    """An interrupt's count and last time."""

    name: str = ""


@dataclass(frozen=True, slots=True)
class TakeLease:
    """Take a lease on part of the board."""

    scope: str = "board"
    exclusive: bool = True
    _: KW_ONLY
    seconds: float = LEASE_SECONDS
    holder: str = ""
    pid: int = 0  # of the holder's process on this machine: the lease ends with it


@dataclass(frozen=True, slots=True)
class RenewLease:
    """Hold a lease for `seconds` from now on."""

    id: str
    seconds: float = LEASE_SECONDS
    _: KW_ONLY
    pid: int = 0  # as in `TakeLease`


@dataclass(frozen=True, slots=True)
class ReleaseLease:
    """Give a lease back."""

    id: str


@dataclass(frozen=True, slots=True)
class BreakLease:
    """End another client's lease, by its number in the status."""

    number: int


Request = (
    ReadStatus
    | ReadConfig
    | ListConfigs
    | PlanChange
    | ChangeMode
    | CancelChange
    | Provision
    | RemoveConfig
    | ReadReg
    | WriteReg
    | DescribeData
    | ConfigureStream
    | DefineMemory
    | ReadData
    | WriteData
    | Upload
    | CheckRegion
    | MapRegion
    | ReadIrq
    | TakeLease
    | RenewLease
    | ReleaseLease
    | BreakLease
)
