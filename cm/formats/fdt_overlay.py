# SPDX-License-Identifier: Apache-2.0
"""A device-tree overlay applied to a tree, as the kernel does it (drivers/of/resolver.c, drivers/of/overlay.c)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from copy import deepcopy

from cm.formats.fdt import FdtError, FdtNode
from cm.frozen import dataclass

_U32 = struct.Struct(">I")


@dataclass(frozen=True, slots=True)
class Applied:
    """A tree with an overlay on it, and the paths of the nodes that the overlay names."""

    root: FdtNode
    paths: frozenset[str]


def missing_labels(base: FdtNode, overlay: FdtNode) -> list[str]:
    """Labels that an overlay names and the tree does not have: the kernel refuses it with -EINVAL."""
    fixups, symbols = overlay.child("__fixups__"), symbols_of(base)
    return [name for name in (fixups.properties if fixups else ()) if name not in symbols]


def targets(overlay: FdtNode) -> dict[str, str]:
    """Fragment → what it changes: a path, or a label, which stands in __fixups__ alone. No fragment without one."""
    fixups = overlay.child("__fixups__")
    found = {fragment.name: fragment.text("target-path") or "" for fragment in overlay.children}
    for label, path, name, _ in _fixups(fixups) if fixups else ():
        if name == "target" and path.lstrip("/") in found:
            found[path.lstrip("/")] = label
    return {fragment: target for fragment, target in found.items() if target}


def symbols_of(root: FdtNode) -> Mapping[str, str]:
    """Label → path; empty for a tree that was built without ``dtc -@``."""
    found = root.child("__symbols__")
    return {name: found.text(name) or "" for name in found.properties} if found else {}


def apply(base: FdtNode, overlay: FdtNode) -> Applied:
    """`base` with `overlay` on it; neither is changed. Raises FdtError for a target or label that is not there."""
    root, overlay = deepcopy(base), deepcopy(overlay)
    nodes = dict(root.walk())
    _renumber(overlay, max((_cell(node, "phandle") for node in nodes.values()), default=0))
    _resolve(overlay, nodes, symbols_of(root))
    handles = {_cell(node, "phandle"): path for path, node in nodes.items() if "phandle" in node.properties}
    paths: set[str] = set()
    places: dict[str, str] = {}  # fragment → path of its target
    for fragment in overlay.children:
        content = fragment.child("__overlay__")
        if content is None:
            continue
        target = fragment.text("target-path") or handles.get(_cell(fragment, "target"), "")
        if target not in nodes:
            raise FdtError(f"{fragment.name}: its target {target or 'phandle'} is not in the tree")
        places[f"/{fragment.name}/__overlay__"] = target.rstrip("/")
        paths.update(path for path, _ in content.walk(target))
        _merge(nodes[target], content)
    _export(root, overlay, places)
    return Applied(root, frozenset(paths))


def _cell(node: FdtNode, name: str) -> int:
    value = node.properties.get(name, b"")
    return int(_U32.unpack_from(value)[0]) if len(value) >= _U32.size else 0


def _add(node: FdtNode, name: str, offset: int, number: int) -> None:
    value = bytearray(node.properties[name])
    _U32.pack_into(value, offset, _U32.unpack_from(value, offset)[0] + number & 0xFFFFFFFF)
    node.properties[name] = bytes(value)


def _renumber(overlay: FdtNode, by: int) -> None:
    """Phandles of an overlay begin behind those of the tree, and so do the references to them within it."""
    for _, node in overlay.walk():
        if "phandle" in node.properties:
            _add(node, "phandle", 0, by)
    local = overlay.child("__local_fixups__")
    nodes = dict(overlay.walk())
    for path, fixup in local.walk() if local else ():
        for name, offsets in fixup.properties.items():
            for (offset,) in _U32.iter_unpack(offsets):
                _add(nodes[path], name, offset, by)


def _resolve(overlay: FdtNode, base: Mapping[str, FdtNode], symbols: Mapping[str, str]) -> None:
    """References to labels of the tree."""
    fixups, nodes = overlay.child("__fixups__"), dict(overlay.walk())
    for label, path, name, offset in _fixups(fixups) if fixups else ():
        target = base.get(symbols.get(label, ""))
        if target is None:
            raise FdtError(f"the tree has no label {label}" if symbols else "the tree has no __symbols__")
        value = bytearray(nodes[path].properties[name])
        _U32.pack_into(value, offset, _cell(target, "phandle"))
        nodes[path].properties[name] = bytes(value)


def _fixups(node: FdtNode) -> Iterator[tuple[str, str, str, int]]:
    for label, value in node.properties.items():
        for place in value.decode("ascii", "replace").split("\0")[:-1]:
            try:
                path, name, offset = place.rsplit(":", 2)
                yield label, path, name, int(offset)
            except ValueError:
                raise FdtError(f"a reference to {label} stands nowhere: {place!r}") from None


def _merge(into: FdtNode, content: FdtNode) -> None:
    into.properties.update(content.properties)
    for child in content.children:
        there = into.child(child.name)
        if there is None:
            into.children.append(child)
        else:
            _merge(there, child)


def _export(root: FdtNode, overlay: FdtNode, places: Mapping[str, str]) -> None:
    """Labels of an overlay are those of the tree, for the overlays after it."""
    symbols = root.child("__symbols__")
    if symbols is None:
        return
    for label, path in symbols_of(overlay).items():
        for place, target in places.items():
            if path.startswith(f"{place}/"):
                symbols.properties[label] = f"{target}{path[len(place) :]}\0".encode()
