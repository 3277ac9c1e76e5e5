# SPDX-License-Identifier: Apache-2.0
"""What a client can ask of the configuration manager."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class ReadStatus:
    """The current `cm.messages.status.Status`."""


@dataclass(frozen=True, slots=True)
class ReadConfig:
    """A configuration's description; of the loaded one if `config_name` is empty.

    `list_names`: the names of all that can be loaded. `plan`: what going to `plan_mode` (its default mode
    if empty) would do.
    """

    config_name: str = ""
    list_names: bool = False
    plan: bool = False
    plan_mode: str = ""


@dataclass(frozen=True, slots=True)
class File:
    """A file that comes with a schema; `data` are its bytes."""

    name: str
    data: bytes
    sha256: str = ""


@dataclass(frozen=True, slots=True)
class WriteConfig:
    """Go to a mode of a configuration, or provision a new configuration.

    `name_or_mode` carries the plain-text spelling of the paper's Listing 2, whose one word may be
    a mode, a module or a configuration; it is resolved against what is loaded.
    """

    config_name: str = ""
    mode: str = ""
    name_or_mode: str = ""
    schema: str = ""
    files: tuple[File, ...] = ()
    provision_only: bool = False
    no_wait: bool = False
    no_queue: bool = False
    cancel: bool = False
    force: bool = False
    lease: str = ""


@dataclass(frozen=True, slots=True)
class ReadReg:
    """Values of registers or fields (``register.field``); of all readable ones if none is named."""

    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RegWrite:
    """One write; with `mask`, a read-modify-write of the bits set in it."""

    name: str
    value: int
    mask: int | None = None


@dataclass(frozen=True, slots=True)
class WriteReg:
    """Several writes, all checked before the first is done, then done in order."""

    writes: tuple[RegWrite, ...]
    lease: str = ""


@dataclass(frozen=True, slots=True)
class DataConfig:
    """Configure a stream; empty, zero or None leaves a property as it is.

    `rate`: frames handed on per second at most; infinity: all that come. `stride`: bytes from line to line.

    With `address` and `length` (bytes) it defines a memory called `stream`, until the next change of configuration;
    `shape`, `dtype`, `access` (rw if empty) and `region` say more of it. With the name of a memory alone it asks.
    """

    stream: str
    shape: tuple[int, ...] = ()
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
    automatic: bool = False  # runs while somebody uses it, as it does before any `enable`
    compression: str = ""  # changes nothing: refused unless frames can be published so
    address: int | None = None
    length: int = 0
    access: str = ""
    region: str = ""  # "static" or a region's name; empty: that of what else is named in the same window


@dataclass(frozen=True, slots=True)
class ReadData:
    """The next frame of a readable stream, or `length` bytes (0: the rest) of a memory of that name."""

    stream: str = ""
    timeout: float = 0.0
    offset: int = 0
    length: int = 0


@dataclass(frozen=True, slots=True)
class WriteData:
    """A frame for a writable stream, or bytes for a memory of that name, from `offset` on; `data` are its bytes."""

    stream: str
    data: bytes | memoryview = field(repr=False, default=b"")
    lease: str = ""
    offset: int = 0


@dataclass(frozen=True, slots=True)
class ReadIrq:
    """An interrupt's count and last time; of all if no name is given."""

    name: str = ""


@dataclass(frozen=True, slots=True)
class TakeLease:
    """Take, renew (`id` given) or give back (`release`) a lease on part of the board."""

    scope: str = "board"
    exclusive: bool = True
    seconds: float = 30.0
    id: str = ""
    release: bool = False
    holder: str = ""
    pid: int = 0  # of the holder's process on this machine: the lease ends with it


Request = (
    ReadStatus | ReadConfig | WriteConfig | ReadReg | WriteReg | DataConfig | ReadData | WriteData | ReadIrq | TakeLease
)
