# SPDX-License-Identifier: Apache-2.0
"""Configurations as clients see them."""

from __future__ import annotations

from collections.abc import Mapping

from cm.manager.state.choice import Choice
from cm.manager.state.table import BoardState
from cm.messages.status import (
    ClockStatus,
    ConfigInfo,
    FieldInfo,
    InterruptInfo,
    MemoryInfo,
    ModeInfo,
    RegionStatus,
    RegisterInfo,
    StreamStatus,
)
from cm.schema.model import Config, Memory, Register, Stream


def config_info(config: Config, mode: str, counts: Mapping[str, int], schema: str) -> ConfigInfo:
    """A configuration; `mode` is empty while it is not loaded, `counts` are its interrupts'."""
    streams = config.modes[mode].streams if mode in config.modes else config.streams
    return ConfigInfo(
        name=config.name,
        type=config.type.value,
        mode=mode,
        modes=tuple(_mode(config, name) for name in config.modes),
        registers=_registers(config),
        interrupts=tuple(InterruptInfo(i.name, i.doc, counts.get(i.name, 0)) for i in config.interrupts.values()),
        streams=tuple(stream_status(x) for x in streams.values()),
        schema=schema,
        memories=_memories(config),
    )


def stream_status(stream: Stream) -> StreamStatus:
    """A stream as the schema has it, not open."""
    return StreamStatus(
        stream.name,
        stream.channel,
        stream.direction.value,
        stream.shape or (),
        stream.dtype,
        stream.slots,
        cyclic=stream.cyclic,
        backpressure=stream.backpressure,
        stride=stream.stride or 0,
        limit=stream.limit or 0.0,
    )


def region_states(
    config: Config | None, state: BoardState, choices: Mapping[tuple[str, str], Choice]
) -> tuple[RegionStatus, ...]:
    """All regions that are known, those of the loaded configuration first."""
    names = dict.fromkeys([*(config.regions if config else ()), *state.regions])
    chosen = {n: choices.get((config.name, n)) for n in names} if config else {}
    return tuple(
        RegionStatus(n, state.region(n).module, state.region(n).phase.value, _loader(chosen.get(n))) for n in names
    )


def _loader(choice: Choice | None) -> str:
    if choice is None:
        return ""
    return f"{choice.kind.value} ({choice.why})" if choice.why else choice.kind.value


def clock_states(config: Config | None, state: BoardState) -> tuple[ClockStatus, ...]:
    """The clocks of the loaded configuration, with the rates that were read back."""
    clocks = config.clocks.values() if config else ()
    return tuple(ClockStatus(clock.name, clock.rate, state.clocks.get(clock.name, 0)) for clock in clocks)


def _mode(config: Config, name: str) -> ModeInfo:
    mode = config.modes[name]
    overlays = tuple(o.name for o in (*config.overlays, *mode.overlays))
    return ModeInfo(name, mode.modules, tuple(config.visible_registers(name)), overlays)


def _registers(config: Config) -> tuple[RegisterInfo, ...]:
    found: dict[str, tuple[Register, list[str]]] = {}
    for mode in config.modes:
        for name, register in config.visible_registers(mode).items():
            found.setdefault(name, (register, []))[1].append(mode)
    return tuple(_register(r, modes, len(config.modes)) for r, modes in found.values())


def _register(r: Register, modes: list[str], of_modes: int) -> RegisterInfo:
    return RegisterInfo(
        name=r.name,
        address=r.address,
        width=r.width,
        access=r.access.value,
        default=r.default,
        minimum=r.minimum,
        maximum=r.maximum,
        doc=r.doc,
        fields=tuple(FieldInfo(f.name, f.lsb, f.width, f.doc, tuple(f.values.items())) for f in r.fields.values()),
        modes=() if len(modes) == of_modes else tuple(modes),
        region=r.region or "",
    )


def _memories(config: Config) -> tuple[MemoryInfo, ...]:
    found: dict[str, tuple[Memory, list[str]]] = {}
    for mode in config.modes:
        for name, memory in config.visible_memories(mode).items():
            found.setdefault(name, (memory, []))[1].append(mode)
    return tuple(memory_info(m, () if len(modes) == len(config.modes) else tuple(modes)) for m, modes in found.values())


def memory_info(m: Memory, modes: tuple[str, ...] = (), defined: bool = False) -> MemoryInfo:
    """A memory; `modes` is empty where all have it."""
    region, shape = m.region or "", m.shape or ()
    return MemoryInfo(m.name, m.address, m.size, m.access.value, m.dtype, shape, region, m.doc, modes, defined)
