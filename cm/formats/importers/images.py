# SPDX-License-Identifier: Apache-2.0
"""The image and the overlay of a dfx-mgr folder. They are found by the folder: names often disagree.

What a device-tree overlay of another project's package does, as far as an import has to know.
"""

from __future__ import annotations

from pathlib import Path

from cm.formats import fdt
from cm.formats.bitstream import BitstreamError, Report, inspect
from cm.formats.importers.result import ImportRefused
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class OverlayInfo:
    """What a device-tree overlay does: what it loads, which devices it adds."""

    firmware: tuple[str, ...]  # names of images that applying it loads
    external: bool  # the fpga is configured by someone else: nothing is loaded
    devices: tuple[str, ...]  # nodes with `compatible`


def overlay_info(data: bytes, name: str = ".dtbo") -> OverlayInfo:
    """Return what an overlay does. Raises `ImportRefused` for what is not a device tree."""
    try:
        tree = fdt.unpack(data)
    except fdt.FdtError as error:
        raise ImportRefused(f"{name}: no whole flattened device tree: {error}") from error
    nodes = [node for _, node in tree.walk()]
    return OverlayInfo(
        firmware=tuple(node.text("firmware-name") or "" for node in nodes if "firmware-name" in node.properties),
        external=any("external-fpga-config" in node.properties for node in nodes),
        devices=tuple(node.name for node in nodes if "compatible" in node.properties),
    )


_SUFFIXES = (".bin", ".bit")


@dataclass(frozen=True, slots=True)
class FoundOverlay:
    """A `.dtbo` and what it does."""

    path: Path
    info: OverlayInfo


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
