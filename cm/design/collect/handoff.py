# SPDX-License-Identifier: Apache-2.0
"""A .hwh (or the XSA, HDF that holds it) → static registers, interrupts, streams, clocks of a runtime schema."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from cm.design.collect.foreign_dma import stream_names
from cm.design.errors import BuildError
from cm.design.hdl.register_maps import identifier, register_of
from cm.formats import hwh
from cm.schema.model import Clock, Direction, Register, Stream

ARCHIVES = (".xsa", ".hdf", ".zip")
MAX_MEMBER = 64 << 20  # bytes of one file in an archive
# one for each kind of damage; RuntimeError: a password is needed
_DAMAGED = (zipfile.BadZipFile, OSError, EOFError, ValueError, zlib.error, lzma.LZMAError, RuntimeError, IndexError)
MAX_ARCHIVE = 512 << 20  # bytes of all files read from an archive


@dataclass(frozen=True, slots=True)
class Handoff:
    """A block design as the vendor's tool describes it; a `partial` one has no processor, and relative addresses."""

    name: str
    design: hwh.Hwh

    @property
    def partial(self) -> bool:
        """The description of a module, not of the whole design."""
        return not any(m.type in _PROCESSORS for m in self.design.modules.values())

    @property
    def device(self) -> str:
        """The device as a runtime schema names it: ``xc7z020``."""
        name = self.design.device.lower()
        return name if name.startswith("x") else f"xc{name}"


_PROCESSORS = ("processing_system7", "zynq_ultra_ps_e", "versal_cips")


def unpack(path: Path, folder: Path) -> list[Path]:
    """The .hwh and .bit files of an archive, written to `folder`."""
    try:
        with zipfile.ZipFile(path) as archive:
            return list(_members(archive, path, folder))
    except _DAMAGED as error:
        raise BuildError(f"{path}: not an XSA or HDF: {error}") from None


def _members(archive: zipfile.ZipFile, path: Path, folder: Path) -> Iterator[Path]:
    names: dict[str, str] = {}
    left = MAX_ARCHIVE
    for info in sorted(archive.infolist(), key=lambda info: info.filename):
        if info.is_dir() or Path(info.filename).suffix.lower() not in (".hwh", ".bit"):
            continue
        left -= info.file_size
        if info.file_size > MAX_MEMBER or left < 0:
            limit = f"{MAX_MEMBER >> 20} MiB a file, {MAX_ARCHIVE >> 20} MiB together"
            raise BuildError(f"{path}: {info.filename} has {info.file_size} bytes: more than an XSA holds ({limit})")
        name = Path(info.filename).name  # never a path out of the archive
        if name in names:
            raise BuildError(f"{path}: {names[name]} and {info.filename} have one name: unpack it and give one of them")
        names[name] = info.filename
        target = folder / name
        # no more than the directory states: zipfile stops there, and the checksum shows what is missing
        target.write_bytes(archive.read(info))
        yield target


def read_handoff(path: Path, source: str = "") -> Handoff:
    """A .hwh file; raises `cm.formats.hwh.HwhError`, which names it `source` if it came from an archive."""
    return Handoff(path.stem, hwh.read(path, source))


def static_registers(design: hwh.Hwh, regions: frozenset[str]) -> dict[str, Register]:
    """Registers of every window outside of regions, called ``<instance>_<register>``.

    Those of DMA engines belong to the kernel's drivers: no UIO device shows them.
    """
    found: dict[str, Register] = {}
    driven = {channel.instance for channel in hwh.dma_channels(design)}
    for window in hwh.windows(design):
        instance = design.modules.get(window.instance)
        if instance is None or window.instance in regions | driven or instance.region:
            continue
        for register in _registers(instance, window):
            found.setdefault(register.name, register)
    return found


def _registers(instance: hwh.ModuleInstance, window: hwh.MemoryRange, region: str | None = None) -> Iterator[Register]:
    blocks = hwh.registers(instance, window.interface) or (
        next(iter(instance.registers.values())) if len(instance.registers) == 1 else ()
    )
    prefix = identifier(instance.name)
    specs = [spec for info in blocks if (spec := register_of(info)).offset + spec.width // 8 <= window.size]
    for spec, others in _without_aliases(specs):
        also = f" Same address: {', '.join(others)}." if others else ""
        yield replace(
            spec,
            name=f"{prefix}_{spec.name}",
            base_address=window.base,
            fields={},
            region=region,
            # the hardware may change it, so it is never verified after a write
            volatile=True,
            doc=f"{spec.doc[:200]}{also}".strip(),
        )


def _without_aliases(specs: Iterable[Register]) -> Iterator[tuple[Register, list[str]]]:
    """Yield each register with the names of others at the same address (a bit in a UART selects between them).

    The first in the file keeps the place, since a schema has one register at each.
    """
    groups: list[tuple[Register, list[str]]] = []
    for spec in specs:
        there = next((group for group in groups if _overlap(group[0], spec)), None)
        if there is None:
            groups.append((spec, []))
        else:
            there[1].append(spec.name)
    yield from groups


def _overlap(one: Register, other: Register) -> bool:
    return one.offset < other.offset + other.width // 8 and other.offset < one.offset + one.width // 8


def module_registers(design: hwh.Hwh, base: int, region: str) -> dict[str, Register]:
    """Read a module's registers from its own .hwh; addresses below `base` are relative, and moved there."""
    found: dict[str, Register] = {}
    for window in hwh.windows(design):
        instance = design.modules.get(window.instance)
        if instance is None:
            continue
        for register in _registers(instance, window, region):
            found.setdefault(register.name, _moved(register, base))
    return found


def _moved(register: Register, base: int) -> Register:
    if register.base_address >= base:
        return register
    return replace(register, base_address=base + register.base_address)


def streams(design: hwh.Hwh) -> dict[str, Stream]:
    """One stream per DMA channel; the name is the engine's if it has only one channel."""
    channels = hwh.dma_channels(design)
    names = stream_names(channels, design)
    found: dict[str, Stream] = {}
    for channel in channels:
        name = names[channel]
        doc = f"{channel.kind} {channel.instance}" + (f", {channel.width} bits a beat" if channel.width else "")
        if channel.limits:
            doc += f"; {channel.limits}"
        found[name] = Stream(name, name, Direction(channel.direction), doc=doc)
    return found


def limits(design: hwh.Hwh) -> list[str]:
    """Say for each stream what its engine cannot do, if it has no scatter/gather."""
    channels = hwh.dma_channels(design)
    names = stream_names(channels, design)
    return [f"stream {names[c]}: {c.instance} has {c.limits}" for c in channels if c.limits]


def clocks(design: hwh.Hwh) -> dict[str, Clock]:
    """PL clocks."""
    return {clock.name: Clock(clock.name, clock.rate) for clock in hwh.clocks(design)}
