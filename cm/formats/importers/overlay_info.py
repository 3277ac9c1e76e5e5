# SPDX-License-Identifier: Apache-2.0
"""What a device-tree overlay of another project's package does, as far as an import has to know."""

from __future__ import annotations

from dataclasses import dataclass

from cm.formats import fdt
from cm.formats.importers.result import ImportRefused


@dataclass(frozen=True, slots=True)
class OverlayInfo:
    """What a device-tree overlay does: what it targets, what it loads, how many devices it adds."""

    targets: tuple[str, ...]  # labels of the base tree, or paths
    firmware: tuple[str, ...]  # names of images that applying it loads
    partial: bool
    external: bool  # the fpga is configured by someone else: nothing is loaded
    devices: tuple[str, ...]  # nodes with `compatible`


def overlay_info(data: bytes, name: str = ".dtbo") -> OverlayInfo:
    """Return what an overlay does. Raises `ImportRefused` for what is not a device tree."""
    try:
        tree = fdt.unpack(data)
    except fdt.FdtError as error:
        raise ImportRefused(f"{name}: no whole flattened device tree: {error}") from error
    nodes = [node for _, node in tree.walk()]
    flags = {name for node in nodes for name in node.properties}
    return OverlayInfo(
        targets=(*_paths(nodes), *_labels(tree)),
        firmware=tuple(node.text("firmware-name") or "" for node in nodes if "firmware-name" in node.properties),
        partial="partial-fpga-config" in flags,
        external="external-fpga-config" in flags,
        devices=tuple(node.name for node in nodes if "compatible" in node.properties),
    )


def _paths(nodes: list[fdt.FdtNode]) -> list[str]:
    return [node.text("target-path") or "" for node in nodes if "target-path" in node.properties]


def _labels(tree: fdt.FdtNode) -> list[str]:
    """The labels of the base tree that fragments target; dtc lists where each is to be inserted."""
    fixups = tree.child("__fixups__")
    places = fixups.properties.items() if fixups is not None else ()
    return [label for label, raw in places if any(place.endswith(b":target:0") for place in raw.split(b"\0"))]
