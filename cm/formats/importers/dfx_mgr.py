# SPDX-License-Identifier: Apache-2.0
"""dfx-mgr packages (Kria): a base folder with shell.json, and accelerators for its slots below it.

A base gives one full configuration; its slots give a second, partial one that runs on it: a region
for each slot, a module and a mode for each accelerator of a slot.
"""

from __future__ import annotations

from pathlib import Path

from cm.formats.importers.dfx_json import Fields
from cm.formats.importers.dfx_slots import import_slots
from cm.formats.importers.images import find_image, find_overlay
from cm.formats.importers.result import Imported, ImportRefused, frozen, static_of, to_name
from cm.schema.model import Config, ConfigType, Mode, Overlay

_KNOWN = ("XRT_FLAT", "PL_FLAT", "PL_DFX")


def import_dfx_mgr(folder: Path) -> Imported:
    """Make runtime schemas of ``/lib/firmware/xilinx/<base>``. Raises `ImportRefused`."""
    folder = folder.resolve()
    shell = Fields.read(_shell_file(folder))
    kind = shell.text("shell_type") or "PL_FLAT"
    if kind not in _KNOWN:
        raise ImportRefused(f"{shell.source}: shell_type {kind}; known are {', '.join(_KNOWN)}")
    notes: list[str] = []
    static = _static(folder, shell, notes)
    device = static.device if static else None
    slots = import_slots(folder, shell, device, notes) if kind == "PL_DFX" else ()
    if kind.startswith("XRT"):
        notes.append("an XRT shell: its .xclbin is for XRT and is not carried over")
    configs = (*((static,) if static else ()), *slots)
    if not configs:
        raise ImportRefused(f"{folder}: neither an image of its own nor accelerators with images")
    return Imported(
        configs=configs,
        notes=tuple(notes),
        links=frozen({name: path for config in slots for name, path in _links(config).items()}),
    )


def _links(config: Config) -> dict[str, Path]:
    """The overlay that loads a module must have the module's name, and lie beside the schema."""
    found = {}
    for module in config.modules.values():
        if config.regions[module.region].loader.value == "overlay" and module.bitstream is not None:
            overlay = find_overlay(module.bitstream.parent, [])
            if overlay is not None:
                found[f"{module.name}.dtbo"] = overlay.path
    return found


def _shell_file(folder: Path) -> Path:
    path = folder / "shell.json"
    if path.is_file():
        return path
    if (folder / "accel.json").is_file():
        raise ImportRefused(f"{folder}: an accelerator; give the folder of its base, the one with shell.json")
    bases = sorted(item.parent.name for item in folder.glob("*/shell.json"))
    hint = f"; folders below it have one: {', '.join(bases)}" if bases else ""
    raise ImportRefused(f"{folder}: no shell.json{hint}")


def _static(folder: Path, shell: Fields, notes: list[str]) -> Config | None:
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
    return Config(
        name=name,
        type=ConfigType.FULL,
        device=image.report.device,
        bitstream=image.path,
        sha256=image.report.sha256,
        overlays=(Overlay(to_name(overlay.path.stem), overlay.path),) if overlay else (),
        modes=frozen({"default": Mode("default")}),
        doc=f"From the dfx-mgr base {folder.name} ({shell.text('shell_type')}, uid {shell.text('uid') or 'none'})",
        static=static_of(shell.text("uid"), image.report),
    )
