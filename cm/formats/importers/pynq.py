# SPDX-License-Identifier: Apache-2.0
"""PYNQ overlays: a `.bit` with its `.hwh` (and `.dtbo`), and the partial bitstreams beside it.

A design gives one full configuration, with a region, modules and modes for its partial bitstreams. Which region a
partial is for is not written in the package. Its name or its `.hwh` usually says so; its frames always do.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from cm.formats import hwh as handoff
from cm.formats.bitstream import BitstreamError, Expectation, Report, footprint_of, inspect, outside, verify
from cm.formats.bitstream.idcodes import base_name
from cm.formats.hwh import DecouplerInfo, DmaChannel, Hwh, HwhError, InterruptLine
from cm.formats.importers.blocks import blocks_of
from cm.formats.importers.overlays import FoundOverlay, firmware_links, overlay_info
from cm.formats.importers.registers import decoupler_of, memories, within
from cm.formats.importers.result import Imported, ImportRefused, Names, frozen, static_of, to_name
from cm.formats.registers import RegisterBank, UniqueNames, identifier
from cm.frozen import dataclass, field, replace
from cm.schema.model import (
    Clock,
    Config,
    ConfigType,
    Decoupler,
    Direction,
    FieldAccess,
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
_NODE = 31  # letters of a node in /dev/cm_dma
# Offset of each status register, and its bits (PG144, PG079, PG090, PG153); of HLS, UG1399, S_AXILITE control
_STATUS: Mapping[str, tuple[tuple[int, Sequence[int]], ...]] = {
    "axi_gpio": ((0x120, (0, 1)),),
    "axi_timer": ((0x00, (8,)), (0x10, (8,))),
    "axi_iic": ((0x20, range(8)),),
    "axi_quad_spi": ((0x20, range(14)),),
}
_HLS_STATUS = 0x0C
_DRIVEN = ("axi_dma", "axi_vdma", "axi_mcdma", "axi_intc", "axi_cdma")


def import_pynq(bit: Path, hwh: Path | None = None, make: MakeOverlay | None = None) -> Imported:
    """Make a runtime schema of a PYNQ overlay; `hwh` is its description, if that has another name.

    `make` makes the overlay of a package that has none.

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
    notes += _strangers(bit, report, design)
    static = _static(bit.resolve(), report, design, links, notes)
    config = _with_regions(static, bit.resolve(), report, design, notes)
    files: dict[str, bytes] = {}
    if not config.overlays and make is not None and handoff.processor(design) is not None:
        files = make(design, config, channel_names(design), notes)
        made = f"{config.name}.dtbo" in files
        config = replace(config, overlays=(Overlay(config.name),) if made else ())
        notes += [f"{name}: made of the .hwh, since the package has none" for name in files]
    elif not config.overlays:
        notes.append(f"{bit.stem}.dtbo: not there; without an overlay no driver is bound, and registers need UIO nodes")
    return Imported((config,), tuple(notes), bit.name, frozen(links), frozen(files))


def _strangers(bit: Path, report: Report, hwh: Hwh) -> list[str]:
    """What says that a .hwh is not of the same build as its bitstream; nothing can prove that it is."""
    version = (report.header.field("Version") if report.header else None) or ""
    if re.match(r"\d{4}\.", version) and hwh.vivado and version != hwh.vivado:
        return [f"{bit.name} was made by Vivado {version}, the .hwh by {hwh.vivado}: they may not belong together"]
    names = (hwh.design, f"{hwh.design}_wrapper")
    if report.design and hwh.design and report.design not in names:
        return [f"{bit.name} is of {report.design}, the .hwh of {hwh.design}: they may not belong together"]
    return []


def described_by(bit: Path) -> Path:
    """The .hwh of a bitstream: of its name, or, as Vivado names them, of ``X`` for ``X_wrapper.bit``."""
    names = (bit.stem, bit.stem.removesuffix("_wrapper"))
    paths = [bit.with_name(f"{name}.hwh") for name in names]
    return next((path for path in paths if path.is_file()), paths[0])


def _handoff(bit: Path, given: Path | None, report: Report) -> Hwh:
    path = given or described_by(bit)
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
    blocks = memories(hwh, notes, streams.values())
    bank = RegisterBank(notes, (*streams, *blocks))
    _registers(hwh, bank, notes)
    interrupts = _interrupts(hwh, bank.registers, notes)
    return Config(
        name=name,
        type=ConfigType.FULL,
        device=report.device,
        bitstream=bit,
        sha256=report.sha256,
        static=static_of(None, report),
        registers=frozen(bank.registers),
        overlays=_overlays(bit, links, notes),
        streams=frozen(streams),
        interrupts=frozen(interrupts),
        clocks=frozen({clock.name: Clock(clock.name, clock.rate) for clock in handoff.clocks(hwh)}),
        modes=frozen({"default": Mode("default")}),
        doc=f"From the PYNQ overlay {bit.name}, design {hwh.design}, Vivado {hwh.vivado}",
        memories=frozen({**blocks, **bank.memories}),
        blocks=frozen(
            {
                block.name: block
                for block in blocks_of(
                    hwh, interrupts, streams, channel_names(hwh), dict(zip(hwh.modules, hwh.modules, strict=True))
                )
            }
        ),
    )


def _registers(hwh: Hwh, bank: RegisterBank, notes: list[str]) -> None:
    blocks = handoff.memories(hwh)
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
            raw = handoff.raw(module, window)
            what = "so the whole window is a memory of words" if raw else "and it is left to the manager"
            notes.append(f"{where}: the .hwh describes no registers, {what}")
            bank.add("", window.base, window.size, raw)


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
    return ()


MakeOverlay: TypeAlias = "Callable[[Hwh, Config, Mapping[DmaChannel, str], list[str]], dict[str, bytes]]"


def channel_names(hwh: Hwh) -> dict[DmaChannel, str]:
    """What channels are called, in the schema and in /dev/cm_dma."""
    names, found = UniqueNames(longest=_NODE), {}
    for channel in handoff.dma_channels(hwh):
        end = f"_{channel.direction}" + (f"_{channel.number}" if channel.kind == "axi_mcdma" else "")
        found[channel] = names.take(identifier(channel.instance)[: _NODE - len(end)] + end)
    return found


def _streams(hwh: Hwh, notes: list[str]) -> dict[str, Stream]:
    names, found = channel_names(hwh), {}
    lines = {(line.instance, line.port): line for line in handoff.interrupts(hwh)}
    for channel in handoff.dma_channels(hwh):
        if channel.kind == "axi_mcdma":
            note = f"{channel.instance}: a multichannel DMA; its channels are left out"
            notes += [note] if note not in notes else []
            continue
        name = names[channel]
        doc = f"{channel.kind} {channel.instance}, {channel.width} bits wide"
        if channel.limits:
            doc += f"; {channel.limits}"
            notes.append(f"stream {name}: {channel.instance} has {channel.limits}")
        line = lines.get((channel.instance, channel.interrupt_port))
        if line is None or line.controller is not None:
            notes.append(f"stream {name}: {_without_interrupt(channel, line)}")
        most = channel.longest if channel.limits else None
        found[name] = Stream(name, channel=name, direction=Direction(channel.direction), doc=doc, max_length=most)
    if found:
        notes.append(
            "streams: shape and dtype are not in the package; the device tree's DMA clients must be called "
            + ", ".join(found)
        )
    return found


def _without_interrupt(channel: DmaChannel, line: InterruptLine | None) -> str:
    port = f"{channel.interrupt_port} of {channel.instance}"
    if line is None:
        why = "is connected to nothing (PYNQ polls): the module cm_intc looks for the end of transfers"
        return f"{port} {why}, where the overlay has a node for it, as the one that the import makes"
    why = f"goes through {line.controller}, an axi_intc, which the module cm_intc serves in an overlay"
    return f"{port} {why} that has its node, as the one that the import makes"


def _interrupts(hwh: Hwh, registers: Mapping[str, Register], notes: list[str]) -> dict[str, Interrupt]:
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
        name = f"{line.instance}_{line.port}".lower()
        at = f"bit {line.index} of {line.controller}" if line.controller else f"PL interrupt {line.index}"
        flags = list(_flags(registers, base, module.type if module else ""))
        for status, bit, acknowledge in flags:
            told = names.take(name)
            doc = f"{at}, bit {bit} of {status}"
            found[told] = Interrupt(told, base, status=status, bit=bit, acknowledge=acknowledge, doc=doc)
        if not flags:
            told = names.take(name)
            found[told] = Interrupt(told, base, doc=at)
            if not line.edge:
                notes.append(
                    f"interrupt {line.port} of {line.instance}: its status is not described; a level stays until"
                )
                notes[-1] += " the program clears it"
    return found


def _flags(registers: Mapping[str, Register], base: int, kind: str) -> Iterator[tuple[str, int, bool]]:
    """The bits that tell an instance's interrupts apart: register, bit, and whether a written 1 clears it."""
    places = _STATUS.get(kind, ((_HLS_STATUS, range(32)),))
    for offset, bits in places:
        for register in registers.values():
            fields = [field for field in register.fields.values() if field.lsb in bits and field.width == 1]
            known = kind in _STATUS or any(field.name.endswith("_int_st") for field in fields)
            if register.base_address == base and register.offset == offset and known:
                for bit in fields:
                    clears = register.access_of(bit) in (FieldAccess.W1C, FieldAccess.W1T)
                    yield register.name, bit.lsb, clears


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


def _with_regions(static: Config, bit: Path, report: Report, hwh: Hwh, notes: list[str]) -> Config:
    """The configuration of a design with a region, modules and modes for its partial bitstreams, if it has any.

    It is one, so that the static part's registers, interrupts and streams stay when a module is loaded.
    """
    partials = list(_find(bit, report, notes))
    if not partials:
        return static
    slots = [Slot(to_name(module.instance), module.instance) for module in hwh.modules.values() if module.region]
    for partial in partials:
        _assign(partial, slots, notes)
    used = [slot for slot in slots if slot.partials]
    modules = {module.name: module for slot in used for module in _modules(slot, hwh, notes)}
    regions = {
        slot.name: Region(slot.name, LoaderKind.FPGA_MANAGER, None, _decoupler(slot, hwh, notes), slot.footprint)
        for slot in used
    }
    modes = {name: Mode(name, modules=(name,)) for name in modules}
    return replace(static, regions=frozen(regions), modules=frozen(modules), modes=frozen({**static.modes, **modes}))


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
        yield Partial(path.resolve(), report, _handoff_of_partial(described_by(path), notes))


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
            place = (window.base, window.size)
            blocks = memories(partial.hwh, notes, prefix=f"{slot.name}_", window=place, region=slot.name)
            bank = RegisterBank(notes, blocks)
            _registers_of_partial(slot, partial.hwh, bank, place, notes)
            registers, blocks = bank.registers, {**blocks, **bank.memories}
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


def _registers_of_partial(slot: Slot, hwh: Hwh, bank: RegisterBank, place: tuple[int, int], notes: list[str]) -> None:
    """A partial's addresses are relative to its region's window, or, of some flows, absolute."""
    base, size = place
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
            room = min(window.size, size - offset)
            raw = [replace(memory, size=room) for memory in handoff.raw(module, window)]
            bank.add(slot.name, base + offset, room, raw, slot.name)
