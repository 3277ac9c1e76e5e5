# SPDX-License-Identifier: Apache-2.0
"""PYNQ overlays: a `.bit` with its `.hwh` (and `.dtbo`), and the partial bitstreams beside it.

A design gives one full configuration; its partial bitstreams give a second, partial one that runs
on it.
"""

from __future__ import annotations

from pathlib import Path

from cm.formats import hwh as handoff
from cm.formats.bitstream import Expectation, Report, inspect, verify
from cm.formats.bitstream.devices import base_name
from cm.formats.hwh import Hwh
from cm.formats.importers.pynq_regions import import_regions
from cm.formats.importers.registers import RegisterBank, memories
from cm.formats.importers.result import Imported, ImportRefused, Names, frozen, static_of, to_name
from cm.schema.model import Clock, Config, ConfigType, Direction, Interrupt, Mode, Overlay, Register, Stream

# Their registers belong to kernel drivers; written behind a driver's back they hang the bus.
_DRIVEN = ("axi_dma", "axi_vdma", "axi_mcdma", "axi_intc", "axi_cdma")


def import_pynq(bit: Path) -> Imported:
    """Make runtime schemas of a PYNQ overlay.

    Raises `ImportRefused`, `HwhError`, or a `BitstreamError` for a bitstream that must not be loaded.
    """
    report = inspect(bit)
    if report.partial:
        raise ImportRefused(
            f"{bit}: a partial bitstream; give the .bit of its static design; partial bitstreams are found beside it"
        )
    verify(report, Expectation(partial=False))
    hwh = _handoff(bit, report)
    notes: list[str] = []
    static = _static(bit.resolve(), report, hwh, notes)
    partial = import_regions(bit.resolve(), report, hwh, static.name, notes)
    return Imported(configs=(static, *partial), notes=tuple(notes))


def _handoff(bit: Path, report: Report) -> Hwh:
    path = bit.with_suffix(".hwh")
    if not path.is_file():
        hint = "; a .tcl is not read, Vivado 2018.3 and later write a .hwh" if bit.with_suffix(".tcl").is_file() else ""
        raise ImportRefused(f"{path}: not there, and nothing else says where the design's registers are{hint}")
    hwh = handoff.read(path)
    if report.device is not None and base_name(hwh.device) != report.device:
        raise ImportRefused(
            f"{path}: is of {hwh.device}, the bitstream of {report.device}: they do not belong together"
        )
    return hwh


def _static(bit: Path, report: Report, hwh: Hwh, notes: list[str]) -> Config:
    name, streams = to_name(bit.stem), _streams(hwh, notes)
    return Config(
        name=name,
        type=ConfigType.FULL,
        device=report.device,
        bitstream=bit,
        sha256=report.sha256,
        static=static_of(None, report),
        registers=frozen(_registers(hwh, notes)),
        overlays=_overlays(bit, notes),
        streams=frozen(streams),
        interrupts=frozen(_interrupts(hwh, notes)),
        clocks=frozen({clock.name: Clock(clock.name, clock.rate) for clock in handoff.clocks(hwh)}),
        modes=frozen({"default": Mode("default")}),
        doc=f"From the PYNQ overlay {bit.name}, design {hwh.design}, Vivado {hwh.vivado}",
        memories=frozen(memories(hwh, notes, streams.values())),
    )


def _registers(hwh: Hwh, notes: list[str]) -> dict[str, Register]:
    bank, blocks = RegisterBank(Names(), notes), handoff.memories(hwh)
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


def _overlays(bit: Path, notes: list[str]) -> tuple[Overlay, ...]:
    path = bit.with_suffix(".dtbo")
    if path.is_file():
        return (Overlay(to_name(bit.stem), path),)
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
