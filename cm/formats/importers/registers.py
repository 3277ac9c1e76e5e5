# SPDX-License-Identifier: Apache-2.0
"""Registers of a `.hwh` as registers of the runtime schema."""

from __future__ import annotations

from collections.abc import Sequence

from cm.formats.hwh import RegisterField, RegisterInfo
from cm.formats.importers.names import Names
from cm.formats.importers.result import frozen
from cm.schema.model import Access, BitField, Register

_ACCESS = {"read-only": Access.RO, "write-only": Access.WO, "read-write": Access.RW}
_WIDTHS = (8, 16, 32, 64)


class RegisterBank:
    """Collects registers; what the schema cannot express as one is left out and noted."""

    def __init__(self, names: Names, notes: list[str]) -> None:
        self._names = names
        self._notes = notes
        self._taken: list[tuple[int, int]] = []
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
        if width is None or info.offset + width // 8 > size:
            return False
        # What Vitis HLS calls Memory_… is an array; its size is not that of a register.
        if info.name.startswith("Memory_") or any(
            begin < end and start < begin + width // 8 for start, end in self._taken
        ):
            return False
        self._taken.append((begin, begin + width // 8))
        name = self._names.take(f"{prefix}_{info.name}".lower())
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
