# SPDX-License-Identifier: Apache-2.0
"""Flattened device trees: as much as an overlay needs (Devicetree Specification 0.4, chapter 5)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

MAGIC = 0xD00DFEED
_HEADER = struct.Struct(">10I")
_BEGIN_NODE, _END_NODE, _PROP, _NOP, _END = 1, 2, 3, 4, 9
_VERSION, _COMPATIBLE = 17, 16


class FdtError(ValueError):
    """Not a flattened device tree, or a damaged one."""


@dataclass(slots=True)
class FdtNode:
    """A node: its properties' raw bytes, and its children in order."""

    name: str = ""
    properties: dict[str, bytes] = field(default_factory=dict)
    children: list[FdtNode] = field(default_factory=list)

    def child(self, name: str) -> FdtNode | None:
        """The child of that name."""
        return next((node for node in self.children if node.name == name), None)

    def text(self, name: str) -> str | None:
        """A property that holds one string."""
        value = self.properties.get(name)
        return None if value is None else value.rstrip(b"\0").decode("utf-8", "replace")

    def walk(self) -> Iterator[FdtNode]:
        """This node and all below it."""
        yield self
        for node in self.children:
            yield from node.walk()


def overlay(target_path: str, content: FdtNode) -> FdtNode:
    """The tree that dtc makes of ``/plugin/; &{target_path} { … };``."""
    content.name = "__overlay__"
    fragment = FdtNode("fragment@0", {"target-path": target_path.encode() + b"\0"}, [content])
    return FdtNode("", {}, [fragment])


def pack(root: FdtNode) -> bytes:
    """The blob of a tree."""
    strings: dict[str, int] = {}
    names = bytearray()
    body = bytearray()
    _pack_node(root, body, strings, names)
    body += struct.pack(">I", _END)
    reserve = bytes(16)
    off_struct = _HEADER.size + len(reserve)
    off_strings = off_struct + len(body)
    total = off_strings + len(names)
    header = _HEADER.pack(
        MAGIC, total, off_struct, off_strings, _HEADER.size, _VERSION, _COMPATIBLE, 0, len(names), len(body)
    )
    return header + reserve + bytes(body) + bytes(names)


def _pack_node(node: FdtNode, body: bytearray, strings: dict[str, int], names: bytearray) -> None:
    body += struct.pack(">I", _BEGIN_NODE) + _padded(node.name.encode() + b"\0")
    for name, value in node.properties.items():
        if name not in strings:
            strings[name] = len(names)
            names += name.encode() + b"\0"
        body += struct.pack(">III", _PROP, len(value), strings[name]) + _padded(value)
    for child in node.children:
        _pack_node(child, body, strings, names)
    body += struct.pack(">I", _END_NODE)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def unpack(blob: bytes) -> FdtNode:
    """The tree of a blob.

    Raises:
        FdtError: it is none, or it is cut off or inconsistent.
    """
    if len(blob) < _HEADER.size:
        raise FdtError("shorter than a header")
    magic, total, off_struct, off_strings, _, version, compatible, _, size_strings, size_struct = _HEADER.unpack_from(
        blob
    )
    if magic != MAGIC:
        raise FdtError(f"magic {magic:#x}, not {MAGIC:#x}")
    if version < _COMPATIBLE or compatible > _VERSION:
        raise FdtError(f"version {version} is not readable")
    if total > len(blob) or off_struct + size_struct > total or off_strings + size_strings > total or off_struct % 4:
        raise FdtError("a block lies outside the blob")
    return _Reader(blob[off_struct : off_struct + size_struct], blob[off_strings : off_strings + size_strings]).tree()


class _Reader:
    def __init__(self, body: bytes, strings: bytes) -> None:
        self._body, self._strings, self._at = body, strings, 0

    def tree(self) -> FdtNode:
        if self._token() != _BEGIN_NODE:
            raise FdtError("the structure does not begin with a node")
        root = self._begin()
        open_nodes = [root]
        while open_nodes:
            token = self._token()
            if token == _BEGIN_NODE:
                node = self._begin()
                open_nodes[-1].children.append(node)
                open_nodes.append(node)
            elif token == _END_NODE:
                open_nodes.pop()
            elif token == _PROP:
                self._property(open_nodes[-1])
            else:
                raise FdtError(f"unknown token {token:#x}")
        if self._token() != _END:
            raise FdtError("something follows the root node")
        return root

    def _token(self) -> int:
        while True:
            token = self._word()
            if token != _NOP:
                return token

    def _word(self) -> int:
        if self._at + 4 > len(self._body):
            raise FdtError("the structure block ends too early")
        self._at += 4
        return int.from_bytes(self._body[self._at - 4 : self._at], "big")

    def _begin(self) -> FdtNode:
        end = self._body.find(b"\0", self._at)
        if end < 0:
            raise FdtError("a name has no end")
        name = self._body[self._at : end].decode("utf-8", "replace")
        self._at = end + 1 + (-(end + 1) % 4)
        return FdtNode(name)

    def _property(self, node: FdtNode) -> None:
        length, offset = self._word(), self._word()
        if self._at + length > len(self._body) or offset >= len(self._strings):
            raise FdtError("a property lies outside its block")
        end = self._strings.find(b"\0", offset)
        name = self._strings[offset : end if end >= 0 else None].decode("utf-8", "replace")
        node.properties[name] = self._body[self._at : self._at + length]
        self._at += length + (-length % 4)
