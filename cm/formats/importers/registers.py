# SPDX-License-Identifier: Apache-2.0
"""What a `.hwh` has, as the runtime schema has it: registers, block RAM as memories, decouplers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cm.formats import hwh as handoff
from cm.formats.hwh import DecouplerInfo, Hwh, MemoryRange, RegisterField, RegisterInfo
from cm.formats.importers.result import Names, frozen
from cm.frozen import replace
from cm.schema.model import Access, BitField, Decoupler, GpioLine, Memory, Register, Stream

_ACCESS = {"read-only": Access.RO, "write-only": Access.WO, "read-write": Access.RW}
_WIDTHS = (8, 16, 32, 64)
_ALSO = "Same address:"


class RegisterBank:
    """Collects registers; what the schema cannot express as one is left out and noted.

    Of several at one address (a bit in a UART selects between them) the first is kept, and its `doc` names the others.
    """

    def __init__(self, names: Names, notes: list[str]) -> None:
        self._names = names
        self._notes = notes
        self._taken: dict[tuple[int, int], str] = {}
        self.registers: dict[str, Register] = {}

    def add(self, prefix: str, base: int, size: int, infos: Sequence[RegisterInfo], region: str | None = None) -> None:
        """Add the registers of a window of `size` bytes at `base`; their names begin with `prefix`."""
        left_out = [info.name for info in infos if not self._add(prefix, base, size, info, region)]
        if left_out:
            shown = ", ".join(left_out[:5]) + (f" and {len(left_out) - 5} more" if len(left_out) > 5 else "")
            self._notes.append(f"{prefix}: no plain registers, left out: {shown}")

    def _add(self, prefix: str, base: int, size: int, info: RegisterInfo, region: str | None) -> bool:
        begin = base + info.offset
        width = _access_width(info.size, begin)
        # What Vitis HLS calls Memory_… is an array; its size is not that of a register.
        if width is None or info.offset + width // 8 > size or info.name.startswith("Memory_"):
            return False
        end = begin + width // 8
        there = next((name for (first, last), name in self._taken.items() if begin < last and first < end), None)
        if there is not None:
            found = self.registers[there]
            more = f"{found.doc.removesuffix('.')}," if _ALSO in found.doc else f"{found.doc} {_ALSO}"
            self.registers[there] = replace(found, doc=f"{more} {info.name.lower()}.".strip())
            return False
        name = self._taken[begin, end] = self._names.take(f"{prefix}_{info.name}".lower())
        self.registers[name] = _register(name, base, width, info, region)
        return True


def _access_width(size: int, address: int) -> int | None:
    """The access for a register of `size` bits: a whole word where it begins one, as AXI4-Lite slaves expect."""
    if 0 < size <= 32 and address % 4 == 0:
        return 32
    return size if size in _WIDTHS and address % (size // 8) == 0 else None


def _register(name: str, base: int, width: int, info: RegisterInfo, region: str | None) -> Register:
    access = _ACCESS.get(info.access, Access.RW)
    fields = [item for item in info.fields if not item.name.upper().startswith("RESERVED")]
    if fields and access is Access.RW and all(item.one_to_clear for item in fields):
        access = Access.W1C
    reset = info.reset if info.reset is not None and not info.reset >> width else None
    return Register(
        name=name,
        base_address=base,
        offset=info.offset,
        width=width,
        access=access,
        reset=None if access is Access.WO else reset,
        fields=frozen(_fields(fields, width)),
        region=region,
        volatile=access is Access.RO or any(item.access == "read-only" or item.one_to_clear for item in fields),
        doc=_one_line(info.doc),
    )


def _fields(infos: Sequence[RegisterField], size: int) -> dict[str, BitField]:
    """Fields that do not overlap; one that covers the whole register is left out."""
    names, found, used = Names(), {}, 0
    for info in infos:
        mask = ((1 << info.width) - 1) << info.lsb
        if info.width < 1 or info.lsb + info.width > size or info.width == size or mask & used:
            continue
        used |= mask
        name = names.take(info.name.lower())
        found[name] = BitField(name, info.lsb, info.width, _one_line(info.doc))
    return found


def _one_line(text: str) -> str:
    return " ".join(text.split())[:500]


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
