# SPDX-License-Identifier: Apache-2.0
"""The slots of a dfx-mgr base and the accelerators for them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.formats.bitstream import footprint_of, outside
from cm.formats.importers.dfx_json import Fields, accel_registers, accel_streams, to_number
from cm.formats.importers.images import FoundImage, FoundOverlay, find_image, find_overlay
from cm.formats.importers.result import Names, frozen, static_of, to_name
from cm.frozen import dataclass
from cm.schema.model import (
    Config,
    ConfigType,
    Decoupler,
    FrameRange,
    IsolationStep,
    LoaderKind,
    Mode,
    Module,
    Overlay,
    Region,
)

_SLOT = re.compile(r"(.+)_slot(\d+)$")
_SUPPORTED = ("XRT_PL_DFX", "SIHA_PL_DFX", "")


@dataclass(frozen=True, slots=True)
class Accelerator:
    """One accelerator for one slot."""

    name: str
    slot: int
    fields: Fields
    image: FoundImage
    overlay: FoundOverlay | None


def import_slots(folder: Path, shell: Fields, device: str | None, notes: list[str]) -> tuple[Config, ...]:
    """Return the partial configuration of a base, or nothing if it has no accelerators."""
    found = list(_accelerators(folder, shell, device, notes))
    footprints = _footprints(found)
    fitting = [item for item in found if _fits(item, footprints, notes)]
    if not fitting:
        return ()
    names = Names()
    modules = {item.name: _module(item, names, notes) for item in fitting}
    by_slot: dict[int, list[Accelerator]] = {}
    for item in sorted(fitting, key=lambda each: each.slot):
        by_slot.setdefault(item.slot, []).append(item)
    base = to_name(folder.name)
    config = Config(
        name=f"{base}_slots",
        type=ConfigType.PARTIAL,
        device=device or fitting[0].image.report.device,
        regions=frozen(
            {f"slot{slot}": _region(slot, items, shell, footprints, notes) for slot, items in by_slot.items()}
        ),
        modules=frozen(modules),
        modes=frozen({item.name: _mode(item, notes) for item in fitting}),
        doc=f"Accelerators of the dfx-mgr base {folder.name}; runs while configuration {base} is loaded",
        static=static_of(shell.text("uid")),
    )
    return (config,)


def _folders(folder: Path) -> Iterator[tuple[Path, int]]:
    """Folders with an image for a slot: ``<accel>/<accel>_slot<N>``, or ``<accel>`` itself for slot 0."""
    for accel in sorted(path for path in folder.iterdir() if path.is_dir()):
        slots = [
            (path, found) for path in sorted(accel.iterdir()) if path.is_dir() and (found := _SLOT.match(path.name))
        ]
        for path, match in slots:
            yield path, int(match.group(2))
        if not slots and (accel / "accel.json").is_file():
            yield accel, 0


def _accelerators(folder: Path, shell: Fields, device: str | None, notes: list[str]) -> Iterator[Accelerator]:
    count = shell.number("num_pl_slots") or shell.number("num_slots")
    for path, slot in _folders(folder):
        file = path / "accel.json"
        file = file if file.is_file() else path.parent / "accel.json"
        fields = Fields.read(file) if file.is_file() and path != folder else Fields(path, {})
        if fields.text("accel_type") not in _SUPPORTED:
            notes.append(f"{path.name}: accel_type {fields.text('accel_type')} is not for the PL, left out")
            continue
        if count is not None and slot >= count:
            notes.append(f"{path.name}: slot {slot}, but shell.json says {count} slots; left out")
            continue
        overlay = find_overlay(path, notes)
        image = find_image(path, overlay, notes)
        if image is None or not _belongs(path, image, device, notes):
            continue
        _compare_ids(path, fields, shell, notes)
        yield Accelerator(to_name(path.name), slot, fields, image, overlay)


def _belongs(path: Path, image: FoundImage, device: str | None, notes: list[str]) -> bool:
    if not image.report.partial:
        notes.append(f"{path.name}: a full bitstream in a slot, left out")
        return False
    if device is not None and image.report.device != device:
        notes.append(f"{path.name}: built for {image.report.device}, the base for {device}; left out")
        return False
    return True


def _compare_ids(path: Path, fields: Fields, shell: Fields, notes: list[str]) -> None:
    parent, own = fields.text("pid"), shell.text("uid")
    if parent and own and to_number(parent, "pid", 16) != to_number(own, "uid", 16):
        notes.append(f"{path.name}: was built for the base with uid {parent}, this one has {own}")


def _footprints(found: list[Accelerator]) -> dict[int, tuple[FrameRange, ...]]:
    """The footprint of each slot: that of its first accelerator."""
    result: dict[int, tuple[FrameRange, ...]] = {}
    for item in found:
        result.setdefault(item.slot, footprint_of(item.image.report))
    return result


def _fits(item: Accelerator, footprints: Mapping[int, tuple[FrameRange, ...]], notes: list[str]) -> bool:
    wrong = outside(item.image.report, footprints[item.slot])
    if wrong:
        notes.append(f"{item.name}: left out: it writes {wrong[0]}, which other accelerators of its slot do not")
    return not wrong


def _module(item: Accelerator, names: Names, notes: list[str]) -> Module:
    return Module(
        name=item.name,
        region=f"slot{item.slot}",
        bitstream=item.image.path,
        sha256=item.image.report.sha256,
        registers=frozen(accel_registers(item.name, f"slot{item.slot}", item.fields, names, notes)),
    )


def _loads_with_devices(item: Accelerator) -> bool:
    return item.overlay is not None and bool(item.overlay.info.firmware) and bool(item.overlay.info.devices)


def _mode(item: Accelerator, notes: list[str]) -> Mode:
    overlays: tuple[Overlay, ...] = ()
    if item.overlay is not None and not item.overlay.info.firmware:
        overlays = (Overlay(to_name(item.overlay.path.stem), item.overlay.path),)
    streams = accel_streams(item.name, f"slot{item.slot}", item.fields, notes)
    return Mode(item.name, modules=(item.name,), overlays=overlays, streams=frozen(streams))


def _region(
    slot: int,
    items: list[Accelerator],
    shell: Fields,
    footprints: Mapping[int, tuple[FrameRange, ...]],
    notes: list[str],
) -> Region:
    """The slot; by overlay where an accelerator's overlay adds devices besides loading the image."""
    by_overlay = any(_loads_with_devices(item) for item in items)
    for item in items:
        if by_overlay and (item.overlay is None or not item.overlay.info.firmware):
            notes.append(
                f"{item.name}: others of slot {slot} are loaded by their overlay, this one has none that loads it"
            )
    return Region(
        name=f"slot{slot}",
        loader=LoaderKind.OVERLAY if by_overlay else LoaderKind.FPGA_MANAGER,
        decoupler=_decoupler(slot, shell, notes),
        footprint=footprints[slot],
    )


def _decoupler(slot: int, shell: Fields, notes: list[str]) -> Decoupler | None:
    """dfx-mgr writes a list of values to a list of registers to connect a slot, and 0 to each to cut it off.

    Source: `acapd_shell_release_isolation` and `acapd_shell_assert_isolation` in its src/shell.c. It reads
    nothing back, so whether these registers can be read is not known.
    """
    slots = shell.items("isolation_slots")
    isolation = slots[slot] if slot < len(slots) else None
    name = shell.text("device_name")
    base = shell.number("reg_base") or to_number(name.partition(".")[0] if "." in name else "", "device_name", 16)
    if isolation is None or base is None:
        notes.append(f"slot{slot}: no isolation is described; it is loaded without being cut off")
        return None
    offsets = [to_number(text, "isolation offset") for text in isolation.texts("offset")]
    values = [to_number(text, "isolation value") for text in isolation.texts("values")]
    writes = [(offset, value) for offset, value in zip(offsets, values, strict=False) if None not in (offset, value)]
    if not writes or len(offsets) != len(values) or len(writes) != len(values):
        counts = f"{len(offsets)} offsets and {len(values)} values"
        notes.append(f"slot{slot}: its isolation has {counts}; it is loaded without being cut off")
        return None
    return _sequence(slot, base, [(offset or 0, value or 0) for offset, value in writes], notes)


def _sequence(slot: int, base: int, writes: list[tuple[int, int]], notes: list[str]) -> Decoupler:
    first = min(offset for offset, _ in writes)
    if len(writes) == 1 and writes[0][1].bit_count() == 1:
        return Decoupler(base, first, bit=writes[0][1].bit_length() - 1, active_high=False)
    notes.append(f"slot{slot}: {len(writes)} registers isolate it; they are written and not read back, as by dfx-mgr")
    steps = (IsolationStep(offset - first, cut=0, couple=value, verify=False) for offset, value in writes)
    return Decoupler(base, first, sequence=tuple(steps))
