# SPDX-License-Identifier: Apache-2.0
"""Configurations as clients see them."""

from __future__ import annotations

from collections.abc import Mapping

from cm.manager.reporting.status import stream_status
from cm.schema.model import Config, Memory, Register
from cm.wire.messages.status import (
    ConfigEntry,
    ConfigInfo,
    FieldInfo,
    InterruptInfo,
    MemoryInfo,
    ModeInfo,
    RegisterInfo,
)

_LONG = 200  # registers


def config_info(
    config: Config, mode: str, counts: Mapping[str, int], schema: str, held: Mapping[str, str | None]
) -> ConfigInfo:
    """A configuration; `mode` is empty while it is not loaded, `counts` are its interrupts', `held` the modules."""
    streams = config.streams_in(mode, held) if mode in config.modes else config.streams
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


def is_long(config: Config | None) -> bool:
    """Whether describing a configuration takes longer than a request may; False where there is none."""
    if config is None:
        return False
    parts = [config.registers, *[m.registers for m in config.modules.values()]]
    return sum(map(len, [*parts, *[m.registers for m in config.modes.values()]])) > _LONG


def config_list(configs: Mapping[str, Config]) -> ConfigInfo:
    """All configurations by name, with their modes."""
    entries = tuple(
        ConfigEntry(name, c.type.value, tuple(c.modes), c.first_mode()) for name, c in sorted(configs.items())
    )
    return ConfigInfo(names=tuple(e.name for e in entries), entries=entries)


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
