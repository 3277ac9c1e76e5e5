# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays, looked at before the kernel is given them (Devicetree Specification 0.4, chapter 5)."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from cm.manager.errors import BadOverlay

_MAGIC = 0xD00DFEED
_HEADER = struct.Struct(">10I")
_BEGIN_NODE, _END_NODE, _PROP, _NOP, _END = 1, 2, 3, 4, 9


def checked_overlay(name: str, blob: bytes) -> bytes:
    """The blob, if it is a whole device tree with an ``__overlay__`` node. Raises BadOverlay."""
    if not any(node == "__overlay__" for node, _, _ in _items(name, blob)):
        raise BadOverlay(f"{name}: no fragment has an __overlay__ node; compile an overlay (/plugin/;) with dtc")
    return blob


def firmware_names(name: str, blob: bytes) -> list[str]:
    """The values of all ``firmware-name`` properties. Raises BadOverlay."""
    return [
        value.rstrip(b"\0").decode("utf-8", "replace") for _, key, value in _items(name, blob) if key == "firmware-name"
    ]


def _items(name: str, blob: bytes) -> Iterator[tuple[str, str, bytes]]:
    """Nodes as (name, "", b""), properties as ("", name, value); every length is checked."""
    try:
        yield from _walk(blob)
    except (struct.error, ValueError) as error:
        raise BadOverlay(f"{name}: not a whole device-tree blob ({error}); compile it with dtc") from error


def _walk(blob: bytes) -> Iterator[tuple[str, str, bytes]]:
    magic, total, structure, strings, _, version, _, _, _, length = _HEADER.unpack_from(blob)
    if magic != _MAGIC or version < 16:
        raise ValueError("it has to begin with d0 0d fe ed, version 16 or 17")
    if total > len(blob) or structure + length > total or strings > total:
        raise ValueError("it is shorter than its header says")
    at, end = structure, structure + length
    while True:
        (token,) = struct.unpack_from(">I", blob, at)
        at += 4
        if at > end or token == _END:
            return
        if token == _BEGIN_NODE:
            stop = blob.index(b"\0", at, end)
            yield blob[at:stop].decode("utf-8", "replace"), "", b""
            at = _aligned(stop + 1)
        elif token == _PROP:
            size, offset = struct.unpack_from(">II", blob, at)
            at += 8
            if at + size > end:
                raise ValueError("a property is longer than the tree")
            key_end = blob.index(b"\0", strings + offset, total)
            yield "", blob[strings + offset : key_end].decode("utf-8", "replace"), blob[at : at + size]
            at = _aligned(at + size)
        elif token not in (_END_NODE, _NOP):
            raise ValueError(f"unknown token {token:#x}")


def _aligned(at: int) -> int:
    return -(-at // 4) * 4
