# SPDX-License-Identifier: Apache-2.0
"""The YAML tree with the position of every key and value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

from cm.frozen import dataclass, field


class Mark(NamedTuple):
    """Position in the text, counted from 1."""

    line: int
    column: int


@dataclass(slots=True)
class Scalar:
    """A value: str, int, float, bool or None; `text` is as it was written."""

    value: Any
    mark: Mark
    text: str


@dataclass(slots=True)
class Items:
    """A sequence."""

    mark: Mark
    items: list[Node] = field(default_factory=list)


@dataclass(slots=True)
class Entry:
    """A value in a mapping, with the position of its key."""

    mark: Mark
    node: Node


@dataclass(slots=True)
class Table:
    """A mapping; `duplicates` are later entries of a key that was there already."""

    mark: Mark
    entries: dict[str, Entry] = field(default_factory=dict)
    duplicates: list[tuple[str, Mark]] = field(default_factory=list)

    def add(self, key: str, entry: Entry) -> None:
        """Add `entry`; the first of a key counts, others are kept as duplicates."""
        if key in self.entries:
            self.duplicates.append((key, entry.mark))
        else:
            self.entries[key] = entry


Node: TypeAlias = Scalar | Items | Table


def plain(node: Node) -> Any:
    """The tree as dicts, lists and values."""
    if isinstance(node, Scalar):
        return node.value
    if isinstance(node, Items):
        return [plain(item) for item in node.items]
    return {key: plain(entry.node) for key, entry in node.entries.items()}


def locate(root: Node, path: Sequence[str | int]) -> Mark:
    """Position of the key at `path`, or of the nearest thing above it that is in the file."""
    node, mark = root, root.mark
    for step in path:
        if isinstance(node, Table) and isinstance(step, str) and step in node.entries:
            entry = node.entries[step]
            node, mark = entry.node, entry.mark
        elif isinstance(node, Items) and isinstance(step, int) and step < len(node.items):
            node = node.items[step]
            mark = node.mark
        else:
            break
    return mark
