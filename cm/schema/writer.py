# SPDX-License-Identifier: Apache-2.0
"""Configuration → normal form: plain values (`to_plain`), and YAML that all readers take alike (`dump`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from enum import Enum
from pathlib import PurePath
from typing import Any

import yaml

from cm.schema.construct import IMAGE_KEYS, STATIC, default_region, only_region
from cm.schema.model import BitField, Block, Config, Decoupler, Memory, Mode, Module, Overlay, Region, Register, Stream
from cm.schema.pictures import CameraInfo, camera_file
from cm.schema.reader import is_octal_trap, resolve


class Hex(int):
    """An integer that is written in hexadecimal."""


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - PyYAML's signature
        return True


def _hex(dumper: _Dumper, value: Hex) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:int", hex(value))


def _text(dumper: _Dumper, value: str) -> yaml.ScalarNode:
    """Quote what a reader might take for something else: a YAML 1.2 number, or a line break that folds."""
    printable = value.replace("\n", "").isprintable()
    plain = printable and isinstance(resolve(value), str) and not is_octal_trap(value)
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if plain else '"')


def _list(dumper: _Dumper, value: list[Any]) -> yaml.SequenceNode:
    """Lists of names and numbers on one line."""
    flat = not any(isinstance(item, (list, dict)) for item in value)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=flat)


_Dumper.add_representer(Hex, _hex)
_Dumper.add_representer(str, _text)
_Dumper.add_representer(list, _list)


def to_yaml(data: dict[str, Any]) -> str:
    """`data` as YAML; the order of keys is kept."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
    return text


_NAMES = {"minimum": "min", "maximum": "max"}
_ADDRESSES = ("base_address", "offset", "identity", "idcode", "user_id")
_VALUES = ("default", "reset", "minimum", "maximum")
_LARGE = 0x100  # from here on a value is easier to read in hexadecimal


def dump(config: Config) -> str:
    """`config` as YAML in normal form; ``loads(dump(config))`` equals it but for where it came from."""
    return to_yaml(to_plain(config))


def to_plain(config: Config) -> dict[str, Any]:
    """`config` as dicts, lists and values in normal form; what is at its default is left out."""
    data: dict[str, Any] = {"name": config.name, "type": config.type.value}
    for key in ("doc", "device", "default_mode"):
        _put(data, key, getattr(config, key))
    _put(data, "idcode", None if config.idcode is None else Hex(config.idcode))
    if config.static is not None:
        data["static"] = _simple(config.static)
    data |= _simple(config, *(field.name for field in fields(config) if field.name not in IMAGE_KEYS))
    _put(data, "regions", {name: _region(region) for name, region in config.regions.items()})
    _put(data, "modules", {name: _module(module) for name, module in config.modules.items()})
    _put(data, "mmio", _windows(config.registers.values(), None))
    _put(data, "memories", _memories(config.memories.values(), None))
    _put(data, "overlays", _overlays(config.overlays))
    _put(data, "streams", {name: _stream(stream, config) for name, stream in config.streams.items()})
    _put(data, "interrupts", {name: _simple(interrupt) for name, interrupt in config.interrupts.items()})
    _put(data, "blocks", {name: _block(block) for name, block in config.blocks.items()})
    _put(data, "clocks", {name: _simple(clock) for name, clock in config.clocks.items()})
    data["modes"] = {name: _mode(mode, config) for name, mode in config.modes.items()}
    return {"config": data}


def _put(data: dict[str, Any], key: str, value: Any) -> None:
    """Add `value` unless it says nothing."""
    if value is None or value == "" or value == {} or value == []:
        return
    data[key] = str(value) if isinstance(value, PurePath) else value


def _simple(thing: Any, *without: str) -> dict[str, Any]:
    """The fields of a dataclass that are not at their defaults, without its name and `without`."""
    data: dict[str, Any] = {}
    for field in fields(thing):
        value = getattr(thing, field.name)
        if field.name in ("name", *without) or value == field.default:
            continue
        if isinstance(value, Enum):
            value = value.value
        if value is not None and (field.name in _ADDRESSES or (field.name in _VALUES and value >= _LARGE)):
            value = Hex(value)
        _put(data, _NAMES.get(field.name, field.name), value)
    return data


def _region(region: Region) -> dict[str, Any]:
    data = _simple(region, "decoupler", "identity", "footprint")
    if region.decoupler is not None:
        data["decoupler"] = _decoupler(region.decoupler)
    if region.identity is not None:
        data["identity"] = _simple(region.identity)
    frames = [
        {"block_type": f.block_type, "row": f.row, "columns": [f.column_first, f.column_last]} for f in region.footprint
    ]
    _put(data, "footprint", frames)
    return data


def _decoupler(decoupler: Decoupler) -> dict[str, Any]:
    if decoupler.gpio is not None:
        line = {"chip": decoupler.gpio.chip, "line": decoupler.gpio.line}
        return {"gpio": line, **_simple(decoupler, "gpio", "sequence", "base_address", "offset")}
    # 0 is an address too
    place = {"base_address": Hex(decoupler.base_address), "offset": Hex(decoupler.offset)}
    data = {**place, **_simple(decoupler, "sequence", "gpio")}
    _put(data, "sequence", [{"offset": Hex(x.offset), **_simple(x, "offset")} for x in decoupler.sequence])
    return data


def _module(module: Module) -> dict[str, Any]:
    data = _simple(module, "registers", "memories")
    _put(data, "mmio", _windows(module.registers.values(), module.region))
    _put(data, "memories", _memories(module.memories.values(), module.region))
    return data


def _mode(mode: Mode, config: Config) -> dict[str, Any]:
    data: dict[str, Any] = {}
    _put(data, "doc", mode.doc)
    _put(data, "modules", list(mode.modules))
    _put(data, "run", mode.run)
    _put(data, "overlays", _overlays(mode.overlays))
    region = default_region(mode.modules, config.modules)
    _put(data, "mmio", _windows(mode.registers.values(), region))
    _put(data, "memories", _memories(mode.memories.values(), region))
    streams = {name: _stream(stream, config, config.streams.get(name)) for name, stream in mode.streams.items()}
    _put(data, "streams", {name: keys for name, keys in streams.items() if keys})
    return data


def _block(block: Block) -> dict[str, Any]:
    place = {"base_address": Hex(block.base_address), "size": Hex(block.size)} if block.size else {}
    data = {"vlnv": block.vlnv, **place, **_simple(block, "vlnv", "base_address", "size")}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in data.items() if value != ""}


def _overlays(overlays: tuple[Overlay, ...]) -> list[Any]:
    return [one.name if one.file is None else {"name": one.name, "file": str(one.file)} for one in overlays]


def _stream(stream: Stream, config: Config, base: Stream | None = None) -> dict[str, Any]:
    """The keys of `stream`; with `base` those that are different there."""
    data: dict[str, Any] = {}
    implied = only_region(config.regions) if stream.region is None else None  # a region is said where there is one
    start = base or Stream(stream.name, stream.name, stream.direction, region=implied)
    for field in fields(stream):
        value = getattr(stream, field.name)
        if value == getattr(start, field.name) and (base is not None or field.name != "direction"):
            continue
        if field.name == "region":
            value = value or STATIC
        value = list(value) if isinstance(value, tuple) else value
        value = camera_file(value) if isinstance(value, CameraInfo) else value
        data[field.name] = value.value if isinstance(value, Enum) else value
    return data


def _windows(registers: Iterable[Register], region: str | None) -> list[dict[str, Any]]:
    """Registers in windows of one base address and region each; `region` is what need not be said."""
    windows: list[dict[str, Any]] = []
    last: tuple[int, str | None] | None = None
    for register in registers:
        place = (register.base_address, register.region)
        if place != last:
            window: dict[str, Any] = {"base_address": Hex(register.base_address)}
            if register.region != region:
                window["region"] = register.region or STATIC
            windows.append(window | {"registers": {}})
            last = place
        windows[-1]["registers"][register.name] = _register(register)
    return windows


def _memories(memories: Iterable[Memory], region: str | None) -> dict[str, Any]:
    """Memories outside of windows, so that they stay in their order; `region` is what need not be said."""
    return {memory.name: _memory(memory, region) for memory in memories}


def _memory(memory: Memory, region: str | None) -> dict[str, Any]:
    data = _simple(memory, "size", "shape", "region")
    data["size"] = Hex(memory.size)
    _put(data, "shape", list(memory.shape or ()))
    if memory.region != region:
        data["region"] = memory.region or STATIC
    return data


def _register(register: Register) -> dict[str, Any]:
    data = _simple(register, "base_address", "region", "fields")
    _put(data, "fields", {name: _field(field) for name, field in register.fields.items()})
    return data


def _field(field: BitField) -> dict[str, Any]:
    data: dict[str, Any] = {"lsb": field.lsb, "width": field.width}
    _put(data, "access", field.access.value if field.access else "")
    _put(data, "doc", field.doc)
    values: Mapping[str, int] = field.values
    _put(data, "values", dict(values))
    return data
