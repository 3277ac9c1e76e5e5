# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays, looked at before the kernel is given them."""

from __future__ import annotations

from cm import fdt
from cm.manager.errors import BadOverlay


def checked_overlay(name: str, blob: bytes) -> bytes:
    """The blob, if it is a whole device tree with an ``__overlay__`` node. Raises BadOverlay."""
    if not any(node.name == "__overlay__" for _, node in _tree(name, blob).walk()):
        raise BadOverlay(f"{name}: no fragment has an __overlay__ node; compile an overlay (/plugin/;) with dtc")
    return blob


def firmware_names(name: str, blob: bytes) -> list[str]:
    """The values of all ``firmware-name`` properties. Raises BadOverlay."""
    found = (node.text("firmware-name") for _, node in _tree(name, blob).walk())
    return [text for text in found if text is not None]


def _tree(name: str, blob: bytes) -> fdt.FdtNode:
    try:
        return fdt.unpack(blob)
    except fdt.FdtError as error:
        raise BadOverlay(f"{name}: not a whole device-tree blob ({error}); compile it with dtc") from error
