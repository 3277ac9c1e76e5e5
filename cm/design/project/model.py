# SPDX-License-Identifier: Apache-2.0
"""The build schema as frozen data: what `cm.design.project.load.load_project` returns.

Paths are absolute; mappings keep the order of the file. Nothing here knows YAML, HDL or a tool.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.boards import BoardDefinition
from cm.frozen import dataclass, field
from cm.schema.model import Clock, LoaderKind, Memory, Register


def empty() -> Mapping[Any, Any]:
    """A read-only empty mapping, for defaults."""
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Resources:
    """Resources of a module or a region; `bram` counts block RAMs of 36 Kbit."""

    lut: int = 0
    ff: int = 0
    bram: float = 0
    dsp: int = 0

    def largest(self, other: Resources) -> Resources:
        """The resources that suffice for either of the two."""
        return Resources(
            max(self.lut, other.lut), max(self.ff, other.ff), max(self.bram, other.bram), max(self.dsp, other.dsp)
        )

    def values(self) -> tuple[int, int, float, int]:
        """The numbers in the order lut, ff, bram, dsp."""
        return self.lut, self.ff, self.bram, self.dsp

    def __bool__(self) -> bool:
        return any(self.values())


@dataclass(frozen=True, slots=True)
class ConnectionSpec:
    """What an interface of a region's boundary is connected to; None: the default for its protocol."""

    connect: str | None = None
    stream: str | None = None
    shape: tuple[int, ...] | None = None
    dtype: str = "uint8"
    format: str | None = None  # of pixels, as in a runtime schema
    slots: int = 8
    rate: float | None = None
    max_length: int | None = None
    engine: str | None = None  # of the DMA: streams with the same name share one
    pins: Mapping[str, tuple[str, ...]] = field(default_factory=empty)  # by signal; "" for a single signal
    iostandard: str | None = None


@dataclass(frozen=True, slots=True)
class SwitchSpec:
    """The stream switch: its streams from memory (`inputs`) and to memory (`outputs`), by name."""

    clock: str
    inputs: Mapping[str, ConnectionSpec] = field(default_factory=empty)
    outputs: Mapping[str, ConnectionSpec] = field(default_factory=empty)


@dataclass(frozen=True, slots=True)
class RegionSpec:
    """A region: `pblock` is empty for auto; `window`: bytes of each of its register windows."""

    name: str
    clock: str
    clocks: Mapping[str, str] = field(default_factory=empty)  # for further clock ports: a clock, or "external"
    pblock: tuple[str, ...] = ()
    resources: Resources = Resources()
    decoupling: bool = True
    loader: LoaderKind = LoaderKind.AUTO
    window: int = 0x10000
    interfaces: Mapping[str, ConnectionSpec] = field(default_factory=empty)
    doc: str = ""


def in_libraries(libraries: Mapping[str, tuple[Path, ...]]) -> tuple[Path, ...]:
    """All files of all libraries, in order."""
    return tuple(path for paths in libraries.values() for path in paths)


@dataclass(frozen=True, slots=True)
class ModuleSpec:
    """A module: HDL with `top`, and the regions it may go to.

    Registers and memories have `offset` in bytes from the start of its window, which has no address yet.
    """

    name: str
    top: str
    regions: tuple[str, ...]
    sources: tuple[Path, ...] = ()
    libraries: Mapping[str, tuple[Path, ...]] = field(default_factory=empty)  # VHDL, by library
    include_dirs: tuple[Path, ...] = ()
    defines: Mapping[str, str] = field(default_factory=empty)
    parameters: Mapping[str, int | float | str | bool] = field(default_factory=empty)
    interface_parameters: Mapping[str, Mapping[str, int | str]] = field(default_factory=empty)  # by port
    flat: tuple[str, str] | None = None  # file and text of a generated wrapper, which is then the top
    ip: tuple[Path, ...] = ()
    ip_repositories: tuple[Path, ...] = ()
    component: Path | None = None
    tcl: tuple[Path, ...] = ()
    constraints: tuple[Path, ...] = ()
    sim_sources: tuple[Path, ...] = ()
    model: str | None = None
    registers: Mapping[str, Register] = field(default_factory=empty)
    memories: Mapping[str, Memory] = field(default_factory=empty)
    register_maps: Mapping[str, Path] = field(default_factory=empty)  # by register interface; "": `interface`
    register_notes: tuple[str, ...] = ()  # what those say that no schema can have, a line each
    interface: str | None = None
    interface_of: Mapping[str, str] = field(default_factory=empty)  # registers and memories of other interfaces
    clocks: Mapping[str, tuple[str, ...]] = field(default_factory=empty)  # port → interfaces on it
    resets: Mapping[str, tuple[str | None, str | None]] = field(default_factory=empty)  # port → clock, low or high
    streams: tuple[str, ...] | None = (
        None  # which of those with valid, data and acknowledge are streams; None: not said
    )
    interrupts: tuple[str, ...] | None = None  # the ports that are; None: not said
    resources: Resources = Resources()
    relocatable: bool = False  # open flow: made for the first region, and moved to the others
    doc: str = ""

    def home(self, region: str) -> str:
        """The region whose implementation goes to `region`, in the open flow."""
        return self.regions[0] if self.relocatable else region

    @property
    def readable(self) -> tuple[Path, ...]:
        """The files in which to find the interfaces: vendor IP cannot be parsed, but its simulation models can."""
        return self.sim_sources if self.ip and self.sim_sources else (*in_libraries(self.libraries), *self.sources)


@dataclass(frozen=True, slots=True)
class ModeStreamSpec:
    """What differs for a stream in a mode; None: as the interface has it."""

    shape: tuple[int, ...] | None = None
    dtype: str | None = None


@dataclass(frozen=True, slots=True)
class ModeSpec:
    """A mode: region → module; regions that are not named keep their modules."""

    name: str
    modules: Mapping[str, str]
    registers: Mapping[str, int] = field(default_factory=empty)
    streams: Mapping[str, ModeStreamSpec] = field(default_factory=empty)
    share: float = 1.0
    doc: str = ""
    run: str | None = None  # as in the runtime schema
    routes: Mapping[str, str] = field(default_factory=empty)  # through the switch: sink → source


@dataclass(frozen=True, slots=True)
class StaticSpec:
    """What the user adds to the static part; `coherent`: its masters are coherent with the processors' caches."""

    sources: tuple[Path, ...] = ()
    libraries: Mapping[str, tuple[Path, ...]] = field(default_factory=empty)
    include_dirs: tuple[Path, ...] = ()
    block_design: tuple[Path, ...] = ()
    constraints: tuple[Path, ...] = ()
    registers: Mapping[str, Register] = field(default_factory=empty)
    coherent: bool = False
    readback: bool = False  # the configuration port can be read too
    revision: str = ""  # part of the identity
    abstract_shells: bool = False  # modules beyond the first run are implemented without the static design


@dataclass(frozen=True, slots=True)
class BitstreamSpec:
    """How bitstreams are written."""

    compress: bool = True
    frame_crc: bool = False


@dataclass(frozen=True, slots=True)
class Project:
    """A build schema. `modes_given`: the file lists modes, so only those combinations are allowed."""

    name: str
    part: str
    source: Path
    board: str | None = None  # Vivado's board part
    kit: BoardDefinition | None = None  # of the board library
    vivado: str | None = None
    doc: str = ""
    clocks: Mapping[str, Clock] = field(default_factory=empty)
    static: StaticSpec = StaticSpec()
    bitstream: BitstreamSpec = BitstreamSpec()
    regions: Mapping[str, RegionSpec] = field(default_factory=empty)
    modules: Mapping[str, ModuleSpec] = field(default_factory=empty)
    modes: Mapping[str, ModeSpec] = field(default_factory=empty)
    modes_given: bool = False
    default_mode: str = ""
    protocols: tuple[Path, ...] = ()
    switch: SwitchSpec | None = None

    @property
    def folder(self) -> Path:
        """The folder that paths in the file are relative to."""
        return self.source.parent

    def modules_of(self, region: str) -> tuple[ModuleSpec, ...]:
        """The modules that may go to `region`, in the order of the file."""
        return tuple(module for module in self.modules.values() if region in module.regions)
