# SPDX-License-Identifier: Apache-2.0
"""Flattened device trees, read, changed and written (Devicetree Specification 0.4, chapter 5).

The one reader of `.dtbo` and `.dtb` files, whether a user sends them, a vendor ships them, or the simulated board is to
apply them. Plain Python, so that a board needs no libfdt. No length, offset or name of a blob is trusted. What dtc
refuses to write is refused here too (two properties of one name, two siblings of one name): readers disagree about
which of the two counts, and a check of one is worthless if the kernel obeys the other.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from cm.frozen import dataclass, field

MAGIC = 0xD00DFEED
MAX_DEPTH = 64  # nodes within nodes; the kernel's unflatten_dt_nodes() has the same limit
_HEADER = struct.Struct(">10I")
_RESERVED = struct.Struct(">2Q")
_BEGIN_NODE, _END_NODE, _PROP, _NOP, _END = 1, 2, 3, 4, 9
_VERSION, _COMPATIBLE = 17, 16


class FdtError(ValueError):
    """Not a flattened device tree, or a damaged one."""


@dataclass(slots=True)
class FdtNode:
    """A node: its properties' raw bytes, and its children, both in order."""

    name: str = ""
    properties: dict[str, bytes] = field(default_factory=dict)
    children: list[FdtNode] = field(default_factory=list)

    def child(self, name: str) -> FdtNode | None:
        """The child of that name."""
        return next((node for node in self.children if node.name == name), None)

    def text(self, name: str) -> str | None:
        """A property's string, the first one of a list; None if it is not there."""
        value = self.properties.get(name)
        return None if value is None else value.split(b"\0")[0].decode("utf-8", "replace")

    def walk(self, path: str = "/") -> Iterator[tuple[str, FdtNode]]:
        """This node and all below it, each after its parent, with their paths."""
        yield path, self
        for node in self.children:
            yield from node.walk(f"{path.rstrip('/')}/{node.name}")


@dataclass(slots=True)
class Fdt:
    """A whole blob: the tree, and what the header and the memory reservation block say."""

    root: FdtNode
    reserved: tuple[tuple[int, int], ...] = ()  # address and length in bytes
    boot_cpu: int = 0


def read_folder(folder: Path) -> FdtNode:
    """A tree as the kernel shows the live one, ``/proc/device-tree``: a folder for each node. Raises OSError."""
    node = FdtNode()
    for entry in sorted(folder.iterdir()):
        if entry.is_dir():
            child = read_folder(entry)
            child.name = entry.name
            node.children.append(child)
        else:
            with suppress(PermissionError):
                node.properties[entry.name] = entry.read_bytes()
    return node


def overlay(target_path: str, content: FdtNode) -> FdtNode:
    """The tree that dtc makes of ``/plugin/; &{target_path} { … };``."""
    content.name = "__overlay__"
    fragment = FdtNode("fragment@0", {"target-path": target_path.encode() + b"\0"}, [content])
    return FdtNode("", {}, [fragment])


def pack(root: FdtNode) -> bytes:
    """The blob of a tree without reservations."""
    return write(Fdt(root))


def write(fdt: Fdt) -> bytes:
    """The blob, version 17; the same bytes for the same tree."""
    strings: dict[str, int] = {}
    names = bytearray()
    body = bytearray()
    _pack_node(fdt.root, body, strings, names)
    body += struct.pack(">I", _END)
    reserved = b"".join(_RESERVED.pack(*entry) for entry in (*fdt.reserved, (0, 0)))
    off_struct = _HEADER.size + len(reserved)
    off_strings = off_struct + len(body)
    words = (MAGIC, off_strings + len(names), off_struct, off_strings, _HEADER.size)
    header = _HEADER.pack(*words, _VERSION, _COMPATIBLE, fdt.boot_cpu, len(names), len(body))
    return header + reserved + bytes(body) + bytes(names)


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
    """The tree of a blob. Raises FdtError as `read`."""
    return read(blob).root


def read(blob: bytes) -> Fdt:
    """All that a blob holds.

    Raises:
        FdtError: it is not a device tree of version 16 or 17, or it is cut off or inconsistent.
    """
    if len(blob) < _HEADER.size:
        raise FdtError(f"{len(blob)} bytes are fewer than a header has")
    magic, total, off_struct, off_strings, off_reserved, version, compatible, boot_cpu, *sizes = _HEADER.unpack_from(
        blob
    )
    if magic != MAGIC:
        raise FdtError(f"it begins with {magic:08x}, not {MAGIC:08x}")
    if version < _COMPATIBLE or compatible > _VERSION:
        raise FdtError(f"version {version} (compatible with {compatible}) is not readable")
    if total > len(blob):
        raise FdtError(f"it is cut off: {total} bytes by its header, {len(blob)} are there")
    size_strings, size_struct = sizes[0], sizes[1] if version >= _VERSION else total - off_struct
    if off_struct + size_struct > total or off_strings + size_strings > total or off_struct % 4:
        raise FdtError("a block lies outside the blob")
    strings = blob[off_strings : off_strings + size_strings]
    root = _Reader(blob[off_struct : off_struct + size_struct], strings).tree()
    return Fdt(root, tuple(_reservations(blob[:total], off_reserved)), boot_cpu)


def _reservations(blob: bytes, at: int) -> Iterator[tuple[int, int]]:
    while at + _RESERVED.size <= len(blob):
        address, length = _RESERVED.unpack_from(blob, at)
        if not (address or length):
            return
        yield address, length
        at += _RESERVED.size
    raise FdtError("the memory reservation block has no end")


class _Reader:
    """Goes through a structure block once."""

    def __init__(self, body: bytes, strings: bytes) -> None:
        self._body, self._strings, self._at = body, strings, 0

    def tree(self) -> FdtNode:
        if self._token() != _BEGIN_NODE:
            raise FdtError("the structure does not begin with a node")
        root = FdtNode(self._node_name())
        parents = [root]
        while parents:
            token = self._token()
            if token == _BEGIN_NODE:
                parents.append(self._child(parents))
            elif token == _END_NODE:
                _check_names(parents.pop())
            elif token == _PROP:
                self._property(parents[-1])
            else:
                raise FdtError(f"unknown token {token:#x} at byte {self._at - 4} of the structure")
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

    def _child(self, parents: list[FdtNode]) -> FdtNode:
        if len(parents) >= MAX_DEPTH:
            raise FdtError(f"nodes are more than {MAX_DEPTH} deep")
        node, parent = FdtNode(self._node_name()), parents[-1]
        if "/" in node.name:
            raise FdtError(f"a node's name {node.name!r} has a slash")
        parent.children.append(node)
        return node

    def _node_name(self) -> str:
        name = _name(self._body, self._at)
        self._at += len(name) + 1 + (-(len(name) + 1) % 4)
        return name

    def _property(self, node: FdtNode) -> None:
        length, offset = self._word(), self._word()
        if self._at + length > len(self._body):
            raise FdtError("a property leaves the structure block")
        name = _name(self._strings, offset)
        if name in node.properties:
            raise FdtError(f"node {node.name!r} has property {name!r} twice")
        node.properties[name] = self._body[self._at : self._at + length]
        self._at += length + (-length % 4)


def _check_names(parent: FdtNode) -> None:
    seen: set[str] = set()
    for node in parent.children:
        if node.name in seen:
            raise FdtError(f"node {parent.name!r} has node {node.name!r} twice")
        seen.add(node.name)


def _name(block: bytes, at: int) -> str:
    end = block.find(b"\0", at)
    if end < 0:
        raise FdtError("a name has no end, or lies outside its block")
    try:
        return block[at:end].decode("ascii")
    except UnicodeDecodeError:
        raise FdtError(f"a name is not ASCII: {block[at:end]!r}") from None
