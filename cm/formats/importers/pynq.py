# SPDX-License-Identifier: Apache-2.0
"""PYNQ overlays: a `.bit` with its `.hwh` (and `.dtbo`), and the partial bitstreams beside it.

A design gives one full configuration; its partial bitstreams give a second, partial one that runs on it. Which region
a partial is for is not written in the package. Its name or its `.hwh` usually says so; its frames always do.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from cm.formats import hwh as handoff
from cm.formats.bitstream import BitstreamError, Expectation, Report, footprint_of, inspect, outside, verify
from cm.formats.bitstream.idcodes import base_name
from cm.formats.hwh import DecouplerInfo, Hwh, HwhError
from cm.formats.importers.overlays import FoundOverlay, firmware_links, overlay_info
from cm.formats.importers.registers import decoupler_of, memories, within
from cm.formats.importers.result import Imported, ImportRefused, Names, frozen, static_of, to_name
from cm.formats.registers import RegisterBank
from cm.frozen import dataclass, field
from cm.schema.model import (
    Clock,
    Config,
    ConfigType,
    Decoupler,
    Direction,
    FrameRange,
    Interrupt,
    LoaderKind,
    Memory,
    Mode,
    Module,
    Overlay,
    Region,
    Register,
    Stream,
)

# Their registers belong to kernel drivers; written behind a driver's back they hang the bus.
_DRIVEN = ("axi_dma", "axi_vdma", "axi_mcdma", "axi_intc", "axi_cdma")


def import_pynq(bit: Path, hwh: Path | None = None) -> Imported:
    """Make runtime schemas of a PYNQ overlay; `hwh` is its description, if that has another name.

    Raises `ImportRefused`, `HwhError`, or a `BitstreamError` for a bitstream that must not be loaded.
    """
    report = inspect(bit)
    if report.partial:
        raise ImportRefused(
            f"{bit}: a partial bitstream; give the .bit of its static design; partial bitstreams are found beside it"
        )
    verify(report, Expectation(partial=False))
    design = _handoff(bit, hwh, report)
    notes: list[str] = []
    links: dict[str, Path] = {}
    static = _static(bit.resolve(), report, design, links, notes)
    partial = import_regions(bit.resolve(), report, design, static.name, notes)
    return Imported(configs=(static, *partial), notes=tuple(notes), source=bit.name, links=frozen(links))


def _described_by(bit: Path) -> Path:
    """The .hwh of a bitstream: of its name, or, as Vivado names them, of ``X`` for ``X_wrapper.bit``."""
    names = (bit.stem, bit.stem.removesuffix("_wrapper"))
    paths = [bit.with_name(f"{name}.hwh") for name in names]
    return next((path for path in paths if path.is_file()), paths[0])


def _handoff(bit: Path, given: Path | None, report: Report) -> Hwh:
    path = given or _described_by(bit)
    if not path.is_file():
        hint = "; a .tcl is not read, Vivado 2018.3 and later write a .hwh" if bit.with_suffix(".tcl").is_file() else ""
        raise ImportRefused(f"{path}: not there, and nothing else says where the design's registers are{hint}")
    hwh = handoff.read(path)
    if report.device is not None and base_name(hwh.device) != report.device:
        raise ImportRefused(
            f"{path}: is of {hwh.device}, the bitstream of {report.device}: they do not belong together"
        )
    return hwh


def _static(bit: Path, report: Report, hwh: Hwh, links: dict[str, Path], notes: list[str]) -> Config:
    name, streams = to_name(bit.stem), _streams(hwh, notes)
    return Config(
        name=name,
        type=ConfigType.FULL,
        device=report.device,
        bitstream=bit,
        sha256=report.sha256,
        static=static_of(None, report),
        registers=frozen(_registers(hwh, notes)),
        overlays=_overlays(bit, links, notes),
        streams=frozen(streams),
        interrupts=frozen(_interrupts(hwh, notes)),
        clocks=frozen({clock.name: Clock(clock.name, clock.rate) for clock in handoff.clocks(hwh)}),
        modes=frozen({"default": Mode("default")}),
        doc=f"From the PYNQ overlay {bit.name}, design {hwh.design}, Vivado {hwh.vivado}",
        memories=frozen(memories(hwh, notes, streams.values())),
    )


def _registers(hwh: Hwh, notes: list[str]) -> dict[str, Register]:
    bank, blocks = RegisterBank(notes), handoff.memories(hwh)
    for window in handoff.windows(hwh):
        module = hwh.modules.get(window.instance)
        if module is None or module.region or window in blocks:
            continue
        where = f"{window.instance} ({module.type}) at 0x{window.base:08x}, {window.size} bytes"
        infos = handoff.registers(module, window.interface)
        if module.type in _DRIVEN:
            notes.append(f"{where}: belongs to a kernel driver, so its registers are left out")
        elif infos:
            bank.add(window.instance, window.base, window.size, infos)
        else:
            notes.append(f"{where}: the .hwh describes no registers; add those you need by hand")
    return bank.registers


def _overlays(bit: Path, links: dict[str, Path], notes: list[str]) -> tuple[Overlay, ...]:
    path = bit.with_suffix(".dtbo")
    if path.is_file():
        try:
            found = FoundOverlay(path, overlay_info(path.read_bytes(), path.name))
            more = firmware_links(found, bit)
        except ImportRefused as error:
            notes.append(str(error).replace(": ", ": left out: ", 1))
            return ()
        name = to_name(bit.stem)
        links |= {**more, f"{name}.dtbo": path} if more else {}
        return (Overlay(name, None if more else path),)
    notes.append(
        f"{path.name}: not there; without an overlay no driver is bound, so registers need UIO nodes otherwise"
    )
    return ()


def _streams(hwh: Hwh, notes: list[str]) -> dict[str, Stream]:
    names, found = Names(), {}
    for channel in handoff.dma_channels(hwh):
        if channel.kind == "axi_mcdma":
            note = f"{channel.instance}: a multichannel DMA; its channels are left out"
            notes += [note] if note not in notes else []
            continue
        name = names.take(f"{channel.instance}_{channel.direction}".lower())
        doc = f"{channel.kind} {channel.instance}, {channel.width} bits wide"
        if channel.limits:
            doc += f"; {channel.limits}"
            notes.append(f"stream {name}: {channel.instance} has {channel.limits}")
        found[name] = Stream(name, channel=name, direction=Direction(channel.direction), doc=doc)
    if found:
        notes.append(
            "streams: shape and dtype are not in the package; the device tree's DMA clients must be called "
            + ", ".join(found)
        )
    return found


def _interrupts(hwh: Hwh, notes: list[str]) -> dict[str, Interrupt]:
    """Interrupts of instances with a window: the line is that of the UIO device at the window."""
    bases = {window.instance: window.base for window in handoff.windows(hwh)}
    names, found, lines = Names(), {}, set()
    for line in handoff.interrupts(hwh):
        module = hwh.modules.get(line.instance)
        if module is not None and module.type in _DRIVEN:
            continue
        base = bases.get(line.instance)
        if base is None or base in lines:
            why = "has no register window" if base is None else "has a second interrupt"
            notes.append(f"interrupt {line.port} of {line.instance}: the instance {why}; name its UIO device by hand")
            continue
        lines.add(base)
        name = names.take(f"{line.instance}_{line.port}".lower())
        at = f"bit {line.index} of {line.controller}" if line.controller else f"PL interrupt {line.index}"
        found[name] = Interrupt(name, base_address=base, doc=at)
    return found


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
        yield Partial(path.resolve(), report, _handoff_of_partial(_described_by(path), notes))


def _handoff_of_partial(path: Path, notes: list[str]) -> Hwh | None:
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
            registers = _registers_of_partial(slot, partial.hwh, window.base, window.size, notes)
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


def _registers_of_partial(slot: Slot, hwh: Hwh, base: int, size: int, notes: list[str]) -> dict[str, Register]:
    """A partial's addresses are relative to its region's window, or, of some flows, absolute."""
    bank = RegisterBank(notes)
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
