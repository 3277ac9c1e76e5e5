# SPDX-License-Identifier: Apache-2.0
"""JSON in which numbers may be strings, hexadecimal or empty, as dfx-mgr's files have them.

What an accel.json says about an accelerator: devices and data movers.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cm.formats.importers.result import ImportRefused, Names
from cm.frozen import dataclass
from cm.schema.model import Direction, Register, Stream


@dataclass(frozen=True, slots=True)
class Fields:
    """A JSON object and the file it is from."""

    source: Path
    values: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> Fields:
        """Read a file. Raises `ImportRefused` for what is not a JSON object."""
        try:
            values = json.loads(path.read_text(encoding="utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise ImportRefused(f"{path}: not JSON: {error}") from error
        if not isinstance(values, dict):
            raise ImportRefused(f"{path}: a JSON object expected, found {type(values).__name__}")
        return cls(path, values)

    def text(self, key: str) -> str:
        """A value as text; empty if it is not there."""
        value = self.values.get(key)
        return str(value).strip() if isinstance(value, (str, int)) and not isinstance(value, bool) else ""

    def number(self, key: str, base: int = 0) -> int | None:
        """A number, or None for one that is not there or empty. Raises `ImportRefused` for other text."""
        return to_number(self.text(key), f"{self.source}: {key}", base)

    def items(self, key: str) -> list[Fields]:
        """The objects in a list."""
        found = self.values.get(key)
        return (
            [Fields(self.source, item) for item in found if isinstance(item, dict)] if isinstance(found, list) else []
        )

    def inner(self, key: str) -> Fields:
        """The object at a key; an empty one if it is not there."""
        found = self.values.get(key)
        return Fields(self.source, found if isinstance(found, dict) else {})

    def texts(self, key: str) -> list[str]:
        """The texts in a list."""
        found = self.values.get(key)
        return [str(item) for item in found] if isinstance(found, list) else []


def to_number(text: str, where: str, base: int = 0) -> int | None:
    """Read a number that may be empty; `base` 16 for those without 0x."""
    if not text:
        return None
    try:
        value = int(text, base)
    except ValueError:
        raise ImportRefused(f"{where}: {text!r} is not a number") from None
    if value < 0:
        raise ImportRefused(f"{where}: {text} is below 0")
    return value


_DIRECTIONS = {"s2mm": Direction.S2MM, "mm2s": Direction.MM2S}
_IGNORED = ("sharedMemoryConfig", "fallbackBehaviour", "accel_metadata")


def accel_registers(prefix: str, region: str, fields: Fields, names: Names, notes: list[str]) -> dict[str, Register]:
    """A device window gives its first word a name: dfx-mgr knows no registers."""
    found = {}
    for device in fields.items("accel_devices"):
        address, _, label = device.text("dev_name").partition(".")
        base = device.number("reg_base") or to_number(address, f"{fields.source}: dev_name", 16)
        if base is None or not label or base % 4:
            notes.append(f"{prefix}: device {device.text('dev_name') or 'without a name'} has no address, left out")
            continue
        size = device.number("reg_size")
        name = names.take(f"{prefix}_{label}".lower())
        doc = f"First word of {device.text('dev_name')}, {size or 'unknown'} bytes"
        found[name] = Register(name, base, 0, region=region, volatile=True, doc=doc)
    if found:
        notes.append(
            f"{prefix}: accel.json names devices, not registers: {', '.join(found)} stand for their first words"
        )
    ignored = [key for key in _IGNORED if fields.values.get(key)]
    if ignored:
        notes.append(f"{prefix}: not carried over: {', '.join(ignored)}")
    return found


def accel_streams(prefix: str, region: str, fields: Fields, notes: list[str]) -> dict[str, Stream]:
    """The data mover's channels."""
    mover = fields.inner("dataMoverConfig")
    names, found = Names(), {}
    for channel in mover.items("dataMoverChnls"):
        direction = _DIRECTIONS.get(channel.text("chnl_dir").lower())
        if direction is None:
            notes.append(f"{prefix}: channel with direction {channel.text('chnl_dir')!r}, left out")
            continue
        name = names.take(f"{prefix}_{direction.value}{channel.text('chnl_id')}".lower())
        doc = f"{mover.text('HWType') or 'data mover'} {mover.text('dma_dev_name')}, channel {channel.text('chnl_id')}"
        found[name] = Stream(name, channel=name, direction=direction, region=region, doc=doc)
    if found:
        notes.append(f"{prefix}: the device tree's DMA clients must be called {', '.join(found)}; shapes are not known")
    return found
