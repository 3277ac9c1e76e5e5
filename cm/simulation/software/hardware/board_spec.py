# SPDX-License-Identifier: Apache-2.0
"""The hardware that a set of runtime schemas asks for, as frozen data: regions, windows, channels, modules."""

from __future__ import annotations

import itertools
import math
import re
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping

from cm.formats.bitstream.idcodes import DEVICES, Device, device_by_name
from cm.formats.bitstream.simulated_module import default_footprint
from cm.frozen import dataclass, field, replace
from cm.schema.model import (
    Access,
    Config,
    Decoupler,
    Direction,
    FrameRange,
    Identity,
    Interrupt,
    Memory,
    Register,
    Stream,
)
from cm.simulation.software.errors import SimError
from cm.wire.lazy_numpy import np


@dataclass(frozen=True, slots=True)
class RegionSpec:
    """A region of the board; its columns of frames are its own."""

    name: str
    footprint: tuple[FrameRange, ...]
    decoupler: Decoupler | None = None
    identity: Identity | None = None


PAGE = 0x1000


@dataclass(frozen=True, slots=True)
class WindowSpec:
    """One UIO device: `size` bytes at physical `address` (0 bytes: an interrupt line only)."""

    name: str
    address: int
    size: int

    @property
    def end(self) -> int:
        """First address behind the window."""
        return self.address + self.size


def windows_of(
    registers: Iterable[Register],
    regions: Iterable[RegionSpec],
    interrupts: Iterable[Interrupt],
    memories: Iterable[Memory] = (),
) -> tuple[WindowSpec, ...]:
    """One window per base address, of a power of two in size; those that overlap become one."""
    reach: dict[int, int] = {}
    owners: dict[int, set[str | None]] = defaultdict(set)

    def need(base: int, end: int, owner: str | None) -> None:
        page = base & ~(PAGE - 1)
        reach[page] = max(reach.get(page, 0), base + end - page)
        owners[page].add(owner)

    for register in registers:
        need(register.base_address, register.offset + register.width // 8, register.region)
    for memory in memories:
        need(memory.base_address, memory.offset + memory.size, memory.region)
    for region in regions:
        for part in (region.decoupler, region.identity):
            if part is not None and part.size:
                need(part.base_address, part.offset + part.size, None if part is region.decoupler else region.name)
    lines = list(interrupts)
    for interrupt in lines:
        if interrupt.base_address is not None and interrupt.base_address & ~(PAGE - 1) not in reach:
            need(interrupt.base_address, 4, None)
    merged = _merge(reach, owners)
    return _named(merged, [line.uio for line in lines if line.uio is not None])


def _merge(reach: dict[int, int], owners: dict[int, set[str | None]]) -> list[tuple[int, int, set[str | None]]]:
    merged: list[tuple[int, int, set[str | None]]] = []
    bases = sorted(reach)
    for index, base in enumerate(bases):
        size = max(PAGE, 1 << (reach[base] - 1).bit_length())
        following = bases[index + 1] if index + 1 < len(bases) else None
        if following is not None and base + size > following >= base + reach[base]:
            size = -(-reach[base] // PAGE) * PAGE  # a power of two would reach into the next: whole pages do not
        if merged and merged[-1][0] + merged[-1][1] > base:
            first, length, who = merged.pop()
            merged.append((first, max(length, base + size - first), who | owners[base]))
        else:
            merged.append((base, size, set(owners[base])))
    return merged


def _named(merged: list[tuple[int, int, set[str | None]]], lines: list[str]) -> tuple[WindowSpec, ...]:
    windows: list[WindowSpec] = []
    used: set[str] = set()
    for base, size, who in merged:
        regions = sorted(name for name in who if name is not None)
        name = regions[0] if len(regions) == 1 and None not in who else "static"
        if name in used:
            name = f"{name}_{base:x}"
        used.add(name)
        windows.append(WindowSpec(name, base, size))
    for line in lines:
        known = used | {f"uio{index}" for index in range(len(windows))}
        if line not in known:
            used.add(line)
            windows.append(WindowSpec(line, 0, 0))
    return tuple(windows)


DEFAULT_RATE = 30.0


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """A DMA channel.

    A memory-to-stream channel feeds its region, and `partner` is the channel that takes the result
    (None: the data is consumed). A stream-to-memory one without a partner is a camera.
    """

    name: str
    direction: Direction
    region: str | None
    shape: tuple[int, ...] | None
    dtype: str
    rate: float
    partner: str | None = None
    vdma: bool = False  # moves lines only
    simple: int = 0  # bits of the length register of an engine without scatter/gather; 0: it has scatter/gather
    quiet: bool = False  # a design says what is before it, so that no camera is
    blind: bool = False  # its driver cannot tell how much arrived

    @property
    def frame_length(self) -> int:
        """Bytes of one frame, or 0 if the schema gives no shape."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize if self.shape else 0

    @property
    def is_camera(self) -> bool:
        """Whether frames come by themselves."""
        return self.direction is Direction.S2MM and self.partner is None and not self.quiet


def channels_of(configs: Iterable[Config]) -> dict[str, ChannelSpec]:
    """The channels of all streams, each paired with the one at the other side of its region, or as a design says."""
    found: dict[str, ChannelSpec] = {}
    given = list(configs)
    for config in given:
        streams = list(config.streams.values())
        for mode in config.modes.values():
            streams.extend(mode.streams.values())
        for stream in streams:
            found.setdefault(stream.channel, _channel(stream))
    for config in given:
        if any(block.peers for block in config.blocks.values()):
            _pair_as_designed(found, config)
    for region in {spec.region for spec in found.values()}:
        _pair(found, region)
    return found


def _pair_as_designed(found: dict[str, ChannelSpec], config: Config) -> None:
    """Pair the channels of a design by its blocks; the first design that names a channel decides."""
    mine = {stream.channel: name for name, stream in config.streams.items() if not found[stream.channel].quiet}
    for channel, name in mine.items():
        found[channel] = replace(found[channel], quiet=True)
        end = (chain(config, name) or [""])[-1]
        sink = config.streams[end].channel if end in config.streams else ""
        if found[channel].direction is Direction.MM2S and sink in mine and found[sink].partner is None:
            found[channel] = replace(found[channel], partner=sink, quiet=True)
            found[sink] = replace(found[sink], partner=channel, quiet=True)


def chain(config: Config, stream: str) -> list[str]:
    """The blocks that a stream to the PL leads through, and the stream from it that it ends at; empty if at none."""
    owner = next((block.name for block in config.blocks.values() if stream in block.streams), None)
    ways: list[list[str]] = [[peer] for peer in config.blocks[owner].peers] if owner else []
    seen: set[str] = {owner} if owner else set()
    while ways:
        way = ways.pop(0)
        if way[-1] in config.streams:
            return way
        if way[-1] not in seen:
            seen.add(way[-1])
            ways += [[*way, peer] for peer in config.blocks[way[-1]].peers]
    return []


def _channel(stream: Stream) -> ChannelSpec:
    rate = stream.rate or DEFAULT_RATE
    return ChannelSpec(stream.channel, stream.direction, stream.region, stream.shape, stream.dtype, rate)


def _pair(found: dict[str, ChannelSpec], region: str | None) -> None:
    """Pair in the order of the file; a channel called camera… is a camera as long as there are others."""
    here: Mapping[str, ChannelSpec] = {n: s for n, s in found.items() if s.region == region and not s.quiet}
    sources = [n for n, s in here.items() if s.direction is Direction.MM2S]
    sinks = [n for n, s in here.items() if s.direction is Direction.S2MM]
    sinks.sort(key=lambda name: "camera" in name or "cam" in name.split("_"))
    for source, sink in zip(sources, sinks, strict=False):
        found[source] = replace(found[source], partner=sink)
        found[sink] = replace(found[sink], partner=source)


STATIC = "static"
_STATIC = "static:"  # of names of registers; no schema can use the colon
DEFAULT_DEVICE = "xc7z020"
_SAFE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*")

REGION_BYTES = 256 * 1024  # of a region whose schema gives no footprint


@dataclass(frozen=True, slots=True)
class ModuleSpec:
    """A module that a schema names, and the registers it answers with, by name."""

    config: str
    name: str
    region: str
    model: str
    identity: int
    registers: Mapping[str, Register] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """Everything that the simulator builds its board from."""

    device: Device
    regions: Mapping[str, RegionSpec]
    modules: tuple[ModuleSpec, ...]
    windows: tuple[WindowSpec, ...]
    channels: Mapping[str, ChannelSpec]
    interrupts: Mapping[str, Interrupt]
    registers: tuple[Register, ...]  # all, with `region` saying which region answers
    configs: tuple[Config, ...] = ()
    memories: tuple[Memory, ...] = ()  # as `registers`

    @classmethod
    def from_configs(cls, configs: Iterable[Config]) -> BoardSpec:
        """The union of what the configurations need.

        Raises:
            SimError: two of them want different devices, or a name is not a file name.
        """
        given = tuple(configs)
        if not given:
            raise SimError("no configuration was given: the board would be empty")
        device = _device(given)
        registers, memories = tuple(_registers(given)), tuple(_memories(given))
        regions = _regions(given, device)
        channels = channels_of([_with_streams(config) for config in given])
        _check_names(channels)
        return cls(
            device=device,
            regions=regions,
            modules=tuple(_modules(given)),
            windows=windows_of(registers, regions.values(), _interrupts(given).values(), memories),
            channels=channels,
            interrupts=_interrupts(given),
            registers=registers,
            configs=given,
            memories=memories,
        )

    def with_static(self, identity: int) -> BoardSpec:
        """The same board with a static part whose identity is `identity`; SimError if it has no register for it."""
        places = [register for register in self.registers if register.name.startswith(_STATIC)]
        if not places:
            raise SimError("no configuration says in which register the static part has its identity")
        if not all(0 <= identity < 1 << register.width for register in places):
            raise SimError(f"{identity:#x} does not fit the identity register of the static part")
        registers = (replace(one, reset=identity) if one in places else one for one in self.registers)
        return replace(self, registers=tuple(registers))


def _device(configs: Iterable[Config]) -> Device:
    wanted: dict[str, Device] = {}
    for config in configs:
        if not config.device:
            continue
        found = device_by_name(config.device)
        if found is None:
            known = ", ".join(item.name for item in DEVICES)
            raise SimError(f"device {config.device} of {config.name} is not known; known are {known}")
        wanted[found.name] = found
    if len(wanted) > 1:
        raise SimError(f"one board has one device, but the configurations name {', '.join(sorted(wanted))}")
    if wanted:
        return next(iter(wanted.values()))
    default = device_by_name(DEFAULT_DEVICE)
    assert default is not None
    return default


def _with_streams(config: Config) -> Config:
    if config.streams or config.blocks or any(mode.streams for mode in config.modes.values()):
        return config
    region = next(iter(config.regions), None)
    shape = (480, 640)
    made = [
        Stream("camera", "camera", Direction.S2MM, shape, region=region, rate=30.0),
        Stream("to_pl", "to_pl", Direction.MM2S, shape, region=region),
        Stream("from_pl", "from_pl", Direction.S2MM, shape, region=region),
    ]
    return replace(config, streams={stream.name: stream for stream in made})


def _check_names(channels: Iterable[str]) -> None:
    for name in channels:
        if not _SAFE.fullmatch(name) or len(name) > 31:
            raise SimError(f"channel {name!r} cannot be a device name: at most 31 letters, digits and _ . + - are")


def _regions(configs: Iterable[Config], device: Device) -> dict[str, RegionSpec]:
    found: dict[str, RegionSpec] = {}
    for config in configs:
        for name, region in config.regions.items():
            known = found.get(name, RegionSpec(name, ()))
            found[name] = RegionSpec(
                name,
                known.footprint or region.footprint,
                known.decoupler or region.decoupler,
                known.identity or region.identity,
            )
    rows = {frames.row for spec in found.values() for frames in spec.footprint}
    return {name: _placed(spec, rows, device) for name, spec in found.items()}


def _placed(spec: RegionSpec, rows: set[int], device: Device) -> RegionSpec:
    """Give a region whose schema says nothing about frames a row of its own."""
    if spec.footprint:
        return spec
    row = next(number for number in itertools.count() if number not in rows)
    rows.add(row)
    return replace(spec, footprint=default_footprint(row, device, REGION_BYTES))


def _interrupts(configs: Iterable[Config]) -> dict[str, Interrupt]:
    return {name: interrupt for config in configs for name, interrupt in config.interrupts.items()}


def _modules(configs: Iterable[Config]) -> Iterator[ModuleSpec]:
    for config in configs:
        for module in config.modules.values():
            visible = dict(config.registers)
            for mode in config.modes.values():
                if module.name in mode.modules:
                    visible.update(mode.registers)
            visible.update(module.registers)
            identity = zlib.crc32(module.name.encode()) if module.identity is None else module.identity
            yield ModuleSpec(config.name, module.name, module.region, module.model or module.name, identity, visible)


def _registers(configs: Iterable[Config]) -> Iterator[Register]:
    yield from _static_identities(configs)
    for config in configs:
        yield from config.registers.values()
        for module in config.modules.values():
            yield from module.registers.values()
        for mode in config.modes.values():
            yield from mode.registers.values()


def _static_identities(configs: Iterable[Config]) -> Iterator[Register]:
    """The static part's identity register: that of the first configuration which names one."""
    places = set()
    for static in (config.static for config in configs):
        if static is None or static.base_address is None or static.identity is None:
            continue
        if (address := static.base_address + static.offset) not in places:
            places.add(address)
            name = f"{_STATIC}{address:#x}"
            yield Register(
                name, static.base_address, static.offset, static.width, Access.RO, reset=static.identity, volatile=True
            )


def _memories(configs: Iterable[Config]) -> Iterator[Memory]:
    for config in configs:
        yield from config.memories.values()
        for module in config.modules.values():
            yield from module.memories.values()
        for mode in config.modes.values():
            yield from mode.memories.values()
