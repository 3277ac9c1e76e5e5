# SPDX-License-Identifier: Apache-2.0
"""The hardware that a set of runtime schemas asks for, as frozen data."""

from __future__ import annotations

import itertools
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from cm.bitstream.devices import DEVICES, Device, device_by_name
from cm.bitstream.module import default_footprint
from cm.schema.model import (
    Access,
    Config,
    Direction,
    Interrupt,
    Memory,
    Register,
    Stream,
)
from cm.sim.errors import SimError
from cm.sim.hardware.channels import ChannelSpec, channels_of
from cm.sim.hardware.regions import RegionSpec
from cm.sim.hardware.windows import WindowSpec, windows_of

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
    if config.streams or any(mode.streams for mode in config.modes.values()):
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
