# SPDX-License-Identifier: Apache-2.0
"""What a `.hwh` has beside registers, as the runtime schema has it: block RAM as memories, decouplers."""

from __future__ import annotations

from collections.abc import Iterable

from cm.formats import hwh as handoff
from cm.formats.hwh import DecouplerInfo, Hwh, MemoryRange
from cm.formats.importers.result import Names
from cm.schema.model import Decoupler, GpioLine, Memory, Stream

_WORD = 4
_LARGEST = 1 << 30  # most bytes that the schema allows


def memories(
    hwh: Hwh,
    notes: list[str],
    streams: Iterable[Stream] = (),
    prefix: str = "",
    window: tuple[int, int] | None = None,
    region: str | None = None,
) -> dict[str, Memory]:
    """A memory for each BRAM controller; `window` is (base, size) of the region that it lies in."""
    names = Names()
    for stream in streams:
        names.take(stream.name)  # a name must belong to one thing only
    found: dict[str, Memory] = {}
    base, limit = window or (0, 1 << 64)
    for item in handoff.memories(hwh):
        offset = within(item.base, base, limit)
        aligned = item.size % _WORD == 0 and item.base % _WORD == 0
        if not aligned or item.size > _LARGEST or offset is None or offset + item.size > limit:
            notes.append(f"{prefix}{_where(item)}: no memory that a schema can have, left out")
            continue
        name = names.take(f"{prefix}{item.instance}")
        found[name] = Memory(name, base + offset, item.size, region=region, doc=f"Block RAM of {item.instance}")
    return found


def within(address: int, base: int, size: int) -> int | None:
    """Return where in a window of `size` bytes at `base` an address lies that is relative to it, or absolute."""
    if base <= address < base + size:
        return address - base
    return address if address < size else None


def _where(item: MemoryRange) -> str:
    return f"{item.instance} at 0x{item.base:x}, {item.size} bytes"


def decoupler_of(info: DecouplerInfo) -> Decoupler | None:
    """The register bit or the processor's line that decouples; None where something else does."""
    if info.chip:
        return Decoupler(gpio=GpioLine(info.chip, info.line))
    return None if info.base is None else Decoupler(info.base, info.offset, info.bit)
