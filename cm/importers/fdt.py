# SPDX-License-Identifier: Apache-2.0
"""The little of a flattened device tree (`.dtbo`) that an import needs; no length in it is trusted."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from cm.importers.result import ImportRefused

_MAGIC = 0xD00DFEED
_BEGIN, _END, _PROP, _NOP, _DONE = 1, 2, 3, 4, 9
_DEPTH = 64


@dataclass(frozen=True, slots=True)
class Node:
    """A node: its path from the root and its properties, raw."""

    path: str
    properties: Mapping[str, bytes]

    def text(self, name: str) -> str | None:
        """A property as a string; None if it is not there."""
        raw = self.properties.get(name)
        return None if raw is None else raw.split(b"\0")[0].decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class OverlayInfo:
    """What a device-tree overlay does: what it targets, what it loads, how many devices it adds."""

    targets: tuple[str, ...]  # labels of the base tree, or paths
    firmware: tuple[str, ...]  # names of images that applying it loads
    partial: bool
    external: bool  # the fpga is configured by someone else: nothing is loaded
    devices: tuple[str, ...]  # nodes with `compatible`


def nodes(data: bytes, name: str = ".dtbo") -> tuple[Node, ...]:
    """Return all nodes in order. Raises `ImportRefused` for what is no whole device tree."""
    try:
        return tuple(_nodes(data))
    except (struct.error, ValueError, IndexError) as error:
        raise ImportRefused(f"{name}: no whole flattened device tree: {error}") from error


def _nodes(data: bytes) -> Iterator[Node]:
    magic, total, at, strings = struct.unpack_from(">4I", data)
    if magic != _MAGIC or total > len(data):
        raise ValueError(f"magic {magic:08x}, {total} bytes said, {len(data)} there")
    path: list[str] = []
    stack: list[dict[str, bytes]] = []
    while True:
        (token,) = struct.unpack_from(">I", data, at)
        at += 4
        if token == _BEGIN:
            text, at = _string(data, at)
            path.append(text)
            stack.append({})
            if len(stack) > _DEPTH:
                raise ValueError(f"nodes {_DEPTH} deep")
        elif token == _PROP:
            length, offset = struct.unpack_from(">2I", data, at)
            if at + 8 + length > len(data):
                raise ValueError(f"property at byte {at} leaves the file")
            stack[-1][_string(data, strings + offset)[0]] = data[at + 8 : at + 8 + length]
            at += 8 + (length + 3) // 4 * 4
        elif token == _END:
            yield Node("/".join(path) or "/", MappingProxyType(stack.pop()))
            path.pop()
        elif token == _DONE:
            return
        elif token != _NOP:
            raise ValueError(f"token {token} at byte {at - 4}")


def _string(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("utf-8", "replace"), (end + 4) // 4 * 4


def overlay_info(data: bytes, name: str = ".dtbo") -> OverlayInfo:
    """Return what an overlay does. Raises `ImportRefused` for what is no device tree."""
    targets: list[str] = []
    firmware: list[str] = []
    devices: list[str] = []
    flags: set[str] = set()
    for node in nodes(data, name):
        if node.path == "/__fixups__":
            targets += [
                label
                for label, raw in node.properties.items()
                if any(x.endswith(b":target:0") for x in raw.split(b"\0"))
            ]
        elif "target-path" in node.properties:
            targets.append(node.text("target-path") or "")
        if "firmware-name" in node.properties:
            firmware.append(node.text("firmware-name") or "")
        flags |= {flag for flag in ("partial-fpga-config", "external-fpga-config") if flag in node.properties}
        if "compatible" in node.properties:
            devices.append(node.path.rsplit("/", 1)[-1])
    return OverlayInfo(
        targets=tuple(targets),
        firmware=tuple(firmware),
        partial="partial-fpga-config" in flags,
        external="external-fpga-config" in flags,
        devices=tuple(devices),
    )
