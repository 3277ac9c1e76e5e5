# SPDX-License-Identifier: Apache-2.0
"""The partial bitstreams of a PYNQ overlay: regions and modules of a partial configuration.

Which region a partial is for is not written in the package. Its name or its `.hwh` usually says so;
its frames always do.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path

from cm.formats import hwh as handoff
from cm.formats.bitstream import BitstreamError, Report, footprint_of, inspect, outside
from cm.formats.hwh import DecouplerInfo, Hwh, HwhError
from cm.formats.importers.registers import RegisterBank, decoupler_of, memories, within
from cm.formats.importers.result import Names, frozen, static_of, to_name
from cm.frozen import dataclass
from cm.schema.model import (
    Config,
    ConfigType,
    Decoupler,
    FrameRange,
    LoaderKind,
    Memory,
    Mode,
    Module,
    Region,
    Register,
)


@dataclass(frozen=True, slots=True)
class Partial:
    """A partial bitstream with what describes it."""

    path: Path
    report: Report
    hwh: Hwh | None


@dataclass(slots=True)
class Slot:
    """A region that is being identified; `instance` is its module in the static design."""

    name: str
    instance: str | None
    footprint: tuple[FrameRange, ...] = ()
    partials: list[Partial] = field(default_factory=list)


def import_regions(bit: Path, report: Report, hwh: Hwh, static: str, notes: list[str]) -> tuple[Config, ...]:
    """Return the partial configuration of a static design, or nothing if it has no partial bitstreams."""
    partials = list(_find(bit, report, notes))
    if not partials:
        return ()
    slots = [Slot(to_name(module.instance), module.instance) for module in hwh.modules.values() if module.region]
    for partial in partials:
        _assign(partial, slots, notes)
    used = [slot for slot in slots if slot.partials]
    modules = {module.name: module for slot in used for module in _modules(slot, hwh, notes)}
    config = Config(
        name=f"{static}_regions",
        type=ConfigType.PARTIAL,
        device=report.device,
        regions=frozen(
            {
                slot.name: Region(
                    slot.name, LoaderKind.FPGA_MANAGER, None, _decoupler(slot, hwh, notes), slot.footprint
                )
                for slot in used
            }
        ),
        modules=frozen(modules),
        modes=frozen({name: Mode(name, modules=(name,)) for name in modules}),
        doc=f"Partial bitstreams of the PYNQ overlay {bit.name}; runs while configuration {static} is loaded",
        static=static_of(None, report),
    )
    return (config,)


def _find(bit: Path, static: Report, notes: list[str]) -> Iterator[Partial]:
    """Partial bitstreams for the same device beside the static one and one folder below."""
    for path in sorted({*bit.parent.glob("*.bit"), *bit.parent.glob("*/*.bit")} - {bit}):
        try:
            report = inspect(path)
        except BitstreamError as error:
            notes.append(f"{path.name}: left out: {error}")
            continue
        if not report.partial or report.device != static.device:
            continue
        if report.problems:
            notes.append(f"{path.name}: left out: {report.problems[0].message}")
            continue
        yield Partial(path.resolve(), report, _handoff(path.with_suffix(".hwh"), notes))


def _handoff(path: Path, notes: list[str]) -> Hwh | None:
    if not path.is_file():
        notes.append(f"{path.name}: not there, so the module has no registers")
        return None
    try:
        return handoff.read(path)
    except HwhError as error:
        notes.append(f"{path.name}: left out: {error}")
        return None


def _assign(partial: Partial, slots: list[Slot], notes: list[str]) -> None:
    frames = footprint_of(partial.report)
    slot = _by_name(partial, slots) or next((x for x in slots if x.partials and _same(partial, x)), None)
    if slot is None:
        names = Names()
        for known in slots:
            names.take(known.name)
        slot = Slot(names.take("prr0") if not slots else names.take(f"prr{len(slots)}"), None)
        slots.append(slot)
    if slot.partials and not _same(partial, slot):
        wrong = outside(partial.report, slot.footprint)
        notes.append(f"{partial.path.name}: left out: by its name for {slot.name}, but it writes {wrong[0]}")
        return
    slot.footprint = slot.footprint or frames
    slot.partials.append(partial)


def _same(partial: Partial, slot: Slot) -> bool:
    return not outside(partial.report, slot.footprint)


def _by_name(partial: Partial, slots: list[Slot]) -> Slot | None:
    """The slot whose instance the file's or design's name holds as whole words; the longest such name."""
    texts = [partial.path.stem, partial.hwh.design if partial.hwh else ""]
    found = [slot for slot in slots if slot.instance and any(_holds(text, slot.instance) for text in texts)]
    return max(found, key=lambda slot: len(slot.name), default=None)


def _holds(text: str, word: str) -> bool:
    return re.search(rf"(?<![A-Za-z0-9]){re.escape(word)}(?![A-Za-z0-9])", text) is not None


def _decoupler(slot: Slot, hwh: Hwh, notes: list[str]) -> Decoupler | None:
    found = [item for item in handoff.decouplers(hwh) if _guards(item, slot)]
    if not found:
        notes.append(f"region {slot.name}: no decoupler found; it is loaded without being cut off")
        return None
    first = found[0]
    decoupler = decoupler_of(first)
    if decoupler is None:
        notes.append(
            f"region {slot.name}: decoupler {first.instance} is driven by {first.driver or 'something else'}, not by a"
            " register in the PL; it is loaded without being cut off"
        )
    return decoupler


def _guards(item: DecouplerInfo, slot: Slot) -> bool:
    return _holds(item.instance, slot.name) or (slot.instance is not None and slot.instance in item.neighbours)


def _modules(slot: Slot, hwh: Hwh, notes: list[str]) -> Iterator[Module]:
    window = next((x for x in handoff.windows(hwh) if x.instance == slot.instance), None)
    for partial in slot.partials:
        name = to_name(partial.path.stem)
        registers: dict[str, Register] = {}
        blocks: dict[str, Memory] = {}
        if partial.hwh is not None and window is not None:
            registers = _registers(slot, partial.hwh, window.base, window.size, notes)
            place = (window.base, window.size)
            blocks = memories(partial.hwh, notes, prefix=f"{slot.name}_", window=place, region=slot.name)
        elif partial.hwh is not None:
            notes.append(f"{name}: the static design says no address for {slot.name}, so its registers are left out")
        yield Module(
            name=name,
            region=slot.name,
            bitstream=partial.path,
            sha256=partial.report.sha256,
            registers=frozen(registers),
            memories=frozen(blocks),
        )


def _registers(slot: Slot, hwh: Hwh, base: int, size: int, notes: list[str]) -> dict[str, Register]:
    """A partial's addresses are relative to its region's window, or, of some flows, absolute."""
    bank = RegisterBank(Names(), notes)
    blocks = handoff.memories(hwh)
    for window in handoff.windows(hwh):
        if window in blocks:
            continue
        prefix = f"{slot.name}_{window.instance}"
        module = hwh.modules.get(window.instance)
        offset = within(window.base, base, size)
        if module is None or offset is None:
            notes.append(f"{prefix} at 0x{window.base:x}: is outside the region's {size} bytes, left out")
            continue
        infos = handoff.registers(module, window.interface)
        if infos:
            bank.add(prefix, base + offset, min(window.size, size - offset), infos, slot.name)
        else:
            notes.append(f"{prefix} ({module.type}) at 0x{base + offset:08x}: no registers are described")
    return bank.registers
