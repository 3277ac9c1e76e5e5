# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays, looked at before the kernel is given them, and changed where they name firmware.

What makes an overlay load something are properties of its ``__overlay__`` nodes, where their target is an
FPGA region (drivers/fpga/of-fpga-region.c: `of_fpga_region_parse_ov`). `firmware-name` deeper in the tree
belongs to the driver of its node, which loads no configuration; the kernel refuses it in an fpga-region.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cm import fdt
from cm.manager.errors import BadOverlay

_NAME = "firmware-name"
_PARTIAL, _ENCRYPTED, _EXTERNAL = "partial-fpga-config", "encrypted-fpga-config", "external-fpga-config"
_KNOWN = (_PARTIAL, _ENCRYPTED, _EXTERNAL)
_DMABUF = "fpga-config-from-dmabuf"  # of linux-xlnx: no file that could be looked at
_LOADING = frozenset({_NAME, _PARTIAL, _ENCRYPTED})


@dataclass(frozen=True, slots=True)
class FirmwareLoad:
    """What an overlay would make the kernel load: a name below /lib/firmware, and what it says of the image."""

    name: str
    partial: bool
    encrypted: bool


def checked_overlay(name: str, blob: bytes) -> bytes:
    """The blob, if it is a whole device tree with an ``__overlay__`` node. Raises BadOverlay."""
    if not any(_targets(_read(name, blob))):
        raise BadOverlay(f"{name}: no fragment has an __overlay__ node; compile an overlay (/plugin/;) with dtc")
    return blob


def firmware_loads(name: str, blob: bytes) -> tuple[FirmwareLoad, ...]:
    """All that applying an overlay would load. Raises BadOverlay, also for what cannot be told beforehand."""
    root = _read(name, blob)
    for _, node in root.walk():
        if _NAME in node.properties and node.name != "__overlay__" and _is_region(node):
            raise BadOverlay(
                f"{name}: node {node.name} adds an fpga-region with {_NAME}, which the kernel refuses: "
                "a region loads when it is there, by an overlay that targets it"
            )
    return tuple(_load(name, node) for node in _targets(root) if _says_of_loading(name, node))


def naming(name: str, blob: bytes, firmware: str) -> bytes:
    """A copy of the overlay whose every ``firmware-name`` is `firmware`."""
    value = firmware.encode() + b"\0"
    return _changed(name, blob, lambda node: {k: value if k == _NAME else v for k, v in node.properties.items()})


def loading_nothing(name: str, blob: bytes) -> bytes:
    """A copy of the overlay that adds what it adds, to a device that is configured already."""

    def kept(node: fdt.FdtNode) -> dict[str, bytes]:
        return {k: v for k, v in node.properties.items() if k not in _LOADING}

    return _changed(name, blob, kept)


def _changed(name: str, blob: bytes, properties: Callable[[fdt.FdtNode], dict[str, bytes]]) -> bytes:
    try:
        tree = fdt.read(blob)
    except fdt.FdtError as error:
        raise _no_tree(name, error) from error
    for node in _targets(tree.root):
        node.properties = properties(node)
    return fdt.write(tree)


def _read(name: str, blob: bytes) -> fdt.FdtNode:
    try:
        return fdt.unpack(blob)
    except fdt.FdtError as error:
        raise _no_tree(name, error) from error


def _no_tree(name: str, error: fdt.FdtError) -> BadOverlay:
    return BadOverlay(f"{name}: not a whole device-tree blob ({error}); compile it with dtc")


def _targets(root: fdt.FdtNode) -> Iterator[fdt.FdtNode]:
    return (node for _, node in root.walk() if node.name == "__overlay__")


def _is_region(node: fdt.FdtNode) -> bool:
    return b"fpga-region" in node.properties.get("compatible", b"").split(b"\0")


def _says_of_loading(name: str, node: fdt.FdtNode) -> bool:
    if _DMABUF in node.properties:
        raise BadOverlay(f"{name}: {_DMABUF} would load what cannot be looked at beforehand; name a file ({_NAME})")
    return _NAME in node.properties


def _unknown(node: fdt.FdtNode) -> str | None:
    """A property by which linux-xlnx takes the image otherwise: user keys, authentication."""
    wanted = (key for key in node.properties if key.endswith("-fpga-config") or key == "encrypted-key-name")
    return next((key for key in wanted if key not in _KNOWN), None)


def _load(name: str, node: fdt.FdtNode) -> FirmwareLoad:
    if _EXTERNAL in node.properties:
        raise BadOverlay(f"{name}: {_NAME} and {_EXTERNAL} in one node contradict each other; the kernel refuses them")
    if (unknown := _unknown(node)) is not None:
        raise BadOverlay(
            f"{name}: {unknown} asks for a way of loading that is not supported; known is {', '.join(_KNOWN)}"
        )
    value = node.properties[_NAME]
    if not value.endswith(b"\0") or value.count(b"\0") != 1 or len(value) < 2:
        raise BadOverlay(f"{name}: its {_NAME} {value!r} is not one name")
    return FirmwareLoad(
        value[:-1].decode("utf-8", "replace"), _PARTIAL in node.properties, _ENCRYPTED in node.properties
    )
