# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays that come with packages of others, and the images that they name."""

from __future__ import annotations

from pathlib import Path

from cm.formats import fdt
from cm.formats.importers.result import ImportRefused
from cm.frozen import dataclass
from cm.schema.named_files import firmware_spellings


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


@dataclass(frozen=True, slots=True)
class FoundOverlay:
    """A `.dtbo` and what it does."""

    path: Path
    info: OverlayInfo


def firmware_links(overlay: FoundOverlay, image: Path) -> dict[str, Path]:
    """Links that have to stand beside the schema, so that the overlay's firmware-name leads to `image`.

    None if a file in the package has that name: the manager finds it. Raises `ImportRefused` for a name in a folder.
    """
    folder = overlay.path.parent
    links = {}
    for name in overlay.info.firmware:
        there = any((folder / other).is_file() for other in (name, *firmware_spellings(name)))
        if there or overlay.info.external:
            continue
        if Path(name).name != name:
            text = f"names the image {name}, which is not there, and {image.name} cannot stand for it in a folder"
            raise ImportRefused(f"{overlay.path}: {text}: give {image.name} that name")
        links[name] = image
    return links
