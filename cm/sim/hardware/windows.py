# SPDX-License-Identifier: Apache-2.0
"""Register windows: which UIO devices a board has, at which addresses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from cm.schema.model import Interrupt, Memory, Register
from cm.sim.hardware.regions import RegionSpec

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
