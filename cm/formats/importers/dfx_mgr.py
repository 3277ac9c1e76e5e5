# SPDX-License-Identifier: Apache-2.0
"""dfx-mgr packages (Kria): a base folder with shell.json, and accelerators for its slots below it.

A base gives one full configuration; its slots give a second, partial one that runs on it: a region
for each slot, a module and a mode for each accelerator of a slot.

In its JSON, numbers may be strings, hexadecimal or empty. Images and overlays are found by the folder: names disagree.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cm.formats.bitstream import BitstreamError, Report, footprint_of, inspect, outside
from cm.formats.importers.overlays import FoundOverlay, firmware_links, overlay_info
from cm.formats.importers.result import Imported, ImportRefused, Names, frozen, static_of, to_name
from cm.frozen import dataclass
from cm.schema.model import (
    Config,
    ConfigType,
    Decoupler,
    Direction,
    FrameRange,
    IsolationStep,
    LoaderKind,
    Mode,
    Module,
    Overlay,
    Region,
    Register,
    Stream,
)

_KNOWN = ("XRT_FLAT", "PL_FLAT", "PL_DFX")


def import_dfx_mgr(folder: Path) -> Imported:
    """Make runtime schemas of ``/lib/firmware/xilinx/<base>``, or of a bare folder of an image and its overlay.

    Raises `ImportRefused`.
    """
    folder = folder.resolve()
    bare = _is_bare(folder)
    shell = Fields(folder, {}) if bare else Fields.read(_shell_file(folder))
    kind = shell.text("shell_type") or "PL_FLAT"
    if kind not in _KNOWN:
        raise ImportRefused(f"{shell.source}: shell_type {kind}; known are {', '.join(_KNOWN)}")
    notes: list[str] = []
    links: dict[str, Path] = {}
    static = None if bare and _is_partial(folder) else _static(folder, shell, links, notes)
    device = static.device if static else None
    slots = import_slots(folder, shell, device, notes) if kind == "PL_DFX" or (bare and static is None) else ()
    if kind.startswith("XRT"):
        notes.append("an XRT shell: its .xclbin is for XRT and is not carried over")
    configs = (*((static,) if static else ()), *slots)
    if not configs:
        raise ImportRefused(f"{folder}: neither an image of its own nor accelerators with images")
    for config in slots:
        _add_links(config, links)
    return Imported(configs=configs, notes=tuple(notes), source=folder.name, links=frozen(links))


def _is_bare(folder: Path) -> bool:
    """Whether it is a package as libdfx and fpgautil take it: an image and its overlay, and no word about them."""
    described = any((folder / name).exists() for name in ("shell.json", "accel.json"))
    return not described and any(folder.glob("*.dtbo")) and any(folder.glob("*.bi[nt]"))


def _is_partial(folder: Path) -> bool:
    image = find_image(folder, find_overlay(folder, []), [])
    return image is not None and image.report.partial


def _add_links(config: Config, links: dict[str, Path]) -> None:
    """The overlay that loads a module must have the module's name and lie beside the schema, and find its image."""
    for module in config.modules.values():
        if config.regions[module.region].loader.value == "overlay" and module.bitstream is not None:
            overlay = find_overlay(module.bitstream.parent, [])
            if overlay is not None:
                links[f"{module.name}.dtbo"] = overlay.path
                for name, image in firmware_links(overlay, module.bitstream).items():
                    if links.setdefault(name, image) != image:
                        both = f"{links[name]} and {image}"
                        raise ImportRefused(f"{overlay.path}: names {name}, which would stand for both {both}")


def _shell_file(folder: Path) -> Path:
    path = folder / "shell.json"
    if path.is_file():
        return path
    if (folder / "accel.json").is_file():
        raise ImportRefused(f"{folder}: an accelerator; give the folder of its base, the one with shell.json")
    bases = sorted(item.parent.name for item in folder.glob("*/shell.json"))
    hint = f"; folders below it have one: {', '.join(bases)}" if bases else ""
    raise ImportRefused(f"{folder}: no shell.json{hint}")


def _static(folder: Path, shell: Fields, links: dict[str, Path], notes: list[str]) -> Config | None:
    overlay = find_overlay(folder, notes)
    image = find_image(folder, overlay, notes)
    if image is None:
        notes.append(f"{folder.name}: no image of the base; its slots run on whatever is loaded")
        return None
    if image.report.partial:
        notes.append(f"{image.path.name}: a partial bitstream in the place of the base's, left out")
        return None
    if overlay is not None and overlay.info.firmware and not overlay.info.external:
        notes.append(f"{overlay.path.name}: names the image (firmware-name); the manager applies it without that")
    if shell.text("load_base_design") == "no":
        notes.append("load_base_design is no: dfx-mgr expects the boot loader to load the base")
    name = to_name(folder.name)
    overlays: tuple[Overlay, ...] = ()
    if overlay is not None:
        found, stem = firmware_links(overlay, image.path), to_name(overlay.path.stem)
        overlays = (Overlay(stem, None if found else overlay.path),)
        links |= {**found, f"{stem}.dtbo": overlay.path} if found else {}
    return Config(
        name=name,
        type=ConfigType.FULL,
        device=image.report.device,
        bitstream=image.path,
        sha256=image.report.sha256,
        overlays=overlays,
        modes=frozen({"default": Mode("default")}),
        doc=f"From the dfx-mgr base {folder.name} ({shell.text('shell_type')}, uid {shell.text('uid') or 'none'})",
        static=static_of(shell.text("uid"), image.report),
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
    if _is_bare(folder):
        yield folder, 0


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


@dataclass(frozen=True, slots=True)
class Fields:
    """A JSON object and the file it is from."""

    source: Path
    values: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> Fields:
        """Read a file. Raises `ImportRefused` for what is not a JSON object."""
        try:
            values = json.loads(path.read_text(encoding="utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise ImportRefused(f"{path}: not JSON: {error}") from error
        if not isinstance(values, dict):
            raise ImportRefused(f"{path}: a JSON object expected, found {type(values).__name__}")
        return cls(path, values)

    def text(self, key: str) -> str:
        """A value as text; empty if it is not there."""
        value = self.values.get(key)
        return str(value).strip() if isinstance(value, (str, int)) and not isinstance(value, bool) else ""

    def number(self, key: str, base: int = 0) -> int | None:
        """A number, or None for one that is not there or empty. Raises `ImportRefused` for other text."""
        return to_number(self.text(key), f"{self.source}: {key}", base)

    def items(self, key: str) -> list[Fields]:
        """The objects in a list."""
        found = self.values.get(key)
        return (
            [Fields(self.source, item) for item in found if isinstance(item, dict)] if isinstance(found, list) else []
        )

    def inner(self, key: str) -> Fields:
        """The object at a key; an empty one if it is not there."""
        found = self.values.get(key)
        return Fields(self.source, found if isinstance(found, dict) else {})

    def texts(self, key: str) -> list[str]:
        """The texts in a list."""
        found = self.values.get(key)
        return [str(item) for item in found] if isinstance(found, list) else []


def to_number(text: str, where: str, base: int = 0) -> int | None:
    """Read a number that may be empty; `base` 16 for those without 0x."""
    if not text:
        return None
    try:
        value = int(text, base)
    except ValueError:
        raise ImportRefused(f"{where}: {text!r} is not a number") from None
    if value < 0:
        raise ImportRefused(f"{where}: {text} is below 0")
    return value


_DIRECTIONS = {"s2mm": Direction.S2MM, "mm2s": Direction.MM2S}
_IGNORED = ("sharedMemoryConfig", "fallbackBehaviour", "accel_metadata")


def accel_registers(prefix: str, region: str, fields: Fields, names: Names, notes: list[str]) -> dict[str, Register]:
    """A device window gives its first word a name: dfx-mgr knows no registers."""
    found = {}
    for device in fields.items("accel_devices"):
        address, _, label = device.text("dev_name").partition(".")
        base = device.number("reg_base") or to_number(address, f"{fields.source}: dev_name", 16)
        if base is None or not label or base % 4:
            notes.append(f"{prefix}: device {device.text('dev_name') or 'without a name'} has no address, left out")
            continue
        size = device.number("reg_size")
        name = names.take(f"{prefix}_{label}".lower())
        doc = f"First word of {device.text('dev_name')}, {size or 'unknown'} bytes"
        found[name] = Register(name, base, 0, region=region, volatile=True, doc=doc)
    if found:
        notes.append(
            f"{prefix}: accel.json names devices, not registers: {', '.join(found)} stand for their first words"
        )
    ignored = [key for key in _IGNORED if fields.values.get(key)]
    if ignored:
        notes.append(f"{prefix}: not carried over: {', '.join(ignored)}")
    return found


def accel_streams(prefix: str, region: str, fields: Fields, notes: list[str]) -> dict[str, Stream]:
    """The data mover's channels."""
    mover = fields.inner("dataMoverConfig")
    names, found = Names(), {}
    for channel in mover.items("dataMoverChnls"):
        direction = _DIRECTIONS.get(channel.text("chnl_dir").lower())
        if direction is None:
            notes.append(f"{prefix}: channel with direction {channel.text('chnl_dir')!r}, left out")
            continue
        name = names.take(f"{prefix}_{direction.value}{channel.text('chnl_id')}".lower())
        doc = f"{mover.text('HWType') or 'data mover'} {mover.text('dma_dev_name')}, channel {channel.text('chnl_id')}"
        found[name] = Stream(name, channel=name, direction=direction, region=region, doc=doc)
    if found:
        notes.append(f"{prefix}: the device tree's DMA clients must be called {', '.join(found)}; shapes are not known")
    return found


_SUFFIXES = (".bin", ".bit")


@dataclass(frozen=True, slots=True)
class FoundImage:
    """A bitstream that may be loaded, as far as can be told from the file alone."""

    path: Path
    report: Report


def _one(paths: list[Path], wanted: list[str], what: str, notes: list[str]) -> Path | None:
    """The path with the expected name, or the first; a choice among several is noted."""
    if not paths:
        return None
    chosen = next((path for name in wanted for path in paths if path.name == name), paths[0])
    if len(paths) > 1:
        notes.append(f"{chosen.parent.name}: {len(paths)} {what}s, taken is {chosen.name}")
    return chosen


def find_overlay(folder: Path, notes: list[str]) -> FoundOverlay | None:
    """Return the folder's `.dtbo`; None if there is none. Raises `ImportRefused` for a damaged one."""
    path = _one(sorted(folder.glob("*.dtbo")), [f"{folder.name}.dtbo"], "overlay", notes)
    return None if path is None else FoundOverlay(path, overlay_info(path.read_bytes(), str(path)))


def find_image(folder: Path, overlay: FoundOverlay | None, notes: list[str]) -> FoundImage | None:
    """Return the folder's bitstream; None, and a note, if there is none that may be loaded."""
    candidates = sorted(path for path in folder.iterdir() if path.suffix in _SUFFIXES and path.is_file())
    named = overlay.info.firmware if overlay else ()
    wanted = [name for text in named for name in (text, text.replace(".bit.bin", ".bin"), text.removesuffix(".bin"))]
    path = _one(candidates, wanted, "image", notes)
    if path is None:
        notes.append(f"{folder.name}: no image ({' or '.join(_SUFFIXES)}) is in it")
        return None
    if named and path.name not in named:
        notes.append(f"{folder.name}: the overlay names {named[0]}, the folder has {path.name}")
    try:
        report = inspect(path)
    except BitstreamError as error:
        notes.append(f"{folder.name}: left out: {error}")
        return None
    if report.problems:
        notes.append(f"{path.name}: left out: {report.problems[0].message}")
        return None
    return FoundImage(path, report)
