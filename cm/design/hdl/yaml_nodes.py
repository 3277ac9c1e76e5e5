# SPDX-License-Identifier: Apache-2.0
"""YAML nodes that know their position, for messages with file, line and column."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import yaml

from cm.design.hdl.errors import HdlError

_Choice = TypeVar("_Choice")
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*")


def compose(text: str, file: str) -> Node | None:
    """The root node; None for an empty document. Raises yaml.YAMLError."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    return None if node is None else Node(node, file)


@dataclass(frozen=True, slots=True)
class Node:
    """One YAML node; every reader raises `HdlError` with the place and what would be right."""

    node: Any
    file: str

    @property
    def where(self) -> str:
        """ "file:line:column", counted from one."""
        mark = self.node.start_mark
        return f"{self.file}:{mark.line + 1}:{mark.column + 1}"

    @property
    def is_scalar(self) -> bool:
        """Whether the node is a plain value: neither a list nor a map."""
        return isinstance(self.node, yaml.ScalarNode)

    def error(self, message: str) -> HdlError:
        """The error to raise for this node."""
        return HdlError(f"{self.where}: {message}")

    def items(self) -> list[tuple[Node, Node]]:
        """Keys and values of a map, in order; a key may occur only once."""
        if not isinstance(self.node, yaml.MappingNode):
            raise self.error("a map (key: value) is expected here")
        pairs = [(Node(key, self.file), Node(value, self.file)) for key, value in self.node.value]
        seen: set[str] = set()
        for key, _ in pairs:
            if key.text() in seen:
                raise key.error(f"the key {key.text()} occurs twice here")
            seen.add(key.text())
        return pairs

    def mapping(self, known: Sequence[str], required: Sequence[str]) -> Mapping[str, Node]:
        """A map with these keys."""
        found = {}
        for key, value in self.items():
            if key.text() not in known:
                raise key.error(f"the key {key.text()} is not known; known are {', '.join(known)}")
            found[key.text()] = value
        lacking = [key for key in required if key not in found]
        if lacking:
            raise self.error(f"the key {', '.join(lacking)} is missing")
        return found

    def sequence(self) -> list[Node]:
        """The items of a list."""
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.error("a list is expected here")
        return [Node(item, self.file) for item in self.node.value]

    def text(self) -> str:
        """A scalar as written."""
        if not self.is_scalar or not self.node.value:
            raise self.error("a name is expected here")
        return str(self.node.value)

    def identifier(self) -> str:
        """A name of letters, digits and `_`."""
        text = self.text()
        if not _IDENTIFIER.fullmatch(text):
            raise self.error(f"{text!r} is not a name: letters, digits and _ only, no digit first")
        return text

    def choice(self, choices: Mapping[str, _Choice]) -> _Choice:
        """One of the words given."""
        text = self.text().lower()
        if text not in choices:
            raise self.error(f"{text!r} must be one of {', '.join(choices)}")
        return choices[text]

    def integer(self, low: int, high: int) -> int:
        """A decimal integer within the bounds, inclusive."""
        text = self.text()
        if not text.isascii() or not text.isdigit() or len(text) > 20 or not low <= int(text) <= high:
            raise self.error(f"{text!r} must be a whole number from {low} to {high}")
        return int(text)

    def boolean(self) -> bool:
        """`true` or `false`."""
        return self.choice({"true": True, "yes": True, "false": False, "no": False})
