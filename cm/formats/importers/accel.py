# SPDX-License-Identifier: Apache-2.0
"""What an accel.json says about an accelerator: devices and data movers."""

from __future__ import annotations

from cm.formats.importers.fields import Fields, to_number
from cm.formats.importers.names import Names
from cm.schema.model import Direction, Register, Stream

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
