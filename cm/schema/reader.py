# SPDX-License-Identifier: Apache-2.0
"""YAML text → tree with positions, safe on any input.

The tree is built from parser events, not by PyYAML's composer: no recursion on the nesting of
the input, no tags, duplicate keys seen, aliases bounded, and the same result with and without
libyaml.

A plain scalar means what the core schema of YAML 1.2 says, with `0b` and `_` in addition. YAML 1.1 would read ``7:4``
as 424, ``010`` as 8 and ``no`` as false; in a file of addresses and bit ranges those are traps. Here ``7:4`` and
``no`` are text, and ``010`` is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import yaml

from cm.schema.tree import Entry, Items, Mark, Node, Scalar, Table

_INTEGER = re.compile(r"[+-]?(?:0|[1-9][0-9_]*|0x[0-9A-Fa-f_]+|0o[0-7_]+|0b[01_]+)")
_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][+-]?[0-9]+)?")
_LEADING_ZERO = re.compile(r"[+-]?0[0-9_]+")
_WORDS: dict[str, Any] = {"": None, "~": None}
_WORDS |= dict.fromkeys(("null", "Null", "NULL"))
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_LONGEST_NUMBER = 80  # digits of a 64-bit number in binary, with underscores


def resolve(text: str) -> Any:
    """The value of the plain scalar `text`: None, bool, int, float or str."""
    if text in _WORDS:
        return _WORDS[text]
    if len(text) > _LONGEST_NUMBER:
        return text
    if _INTEGER.fullmatch(text) and text[-1] != "_":
        return _integer(text)
    if _FLOAT.fullmatch(text):
        value = float(text)
        return value if math.isfinite(value) else text
    return text


def is_octal_trap(text: str) -> bool:
    """Whether `text` is a number with a leading zero, which readers of YAML disagree about."""
    return _LEADING_ZERO.fullmatch(text) is not None


def _integer(text: str) -> Any:
    try:
        return int(text.replace("_", ""), 0)
    except ValueError:  # "0x_" has no digits
        return text


MAX_BYTES = 1 << 20
MAX_DEPTH = 32
MAX_NODES = 100_000  # aliases counted as often as they are used

Report = Callable[[Mark, str, str, str], None]  # mark, code, message, hint


class Refused(Exception):
    """Reading cannot continue, and why."""

    def __init__(self, mark: Mark, code: str, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.mark, self.code, self.message, self.hint = mark, code, message, hint


def read(text: str, report: Report, loader: Any = None) -> Node:
    """The tree of the one document in `text`; raises `Refused` if there is none.

    `report` is told of errors after which reading goes on. `loader` is a PyYAML loader class,
    by default the one over libyaml where PyYAML has it.
    """
    try:
        size = len(text.encode())
    except UnicodeEncodeError as error:
        raise Refused(_mark_at(text, error.start), "yaml_syntax", "a character that is not Unicode text") from None
    if size > MAX_BYTES:
        raise Refused(Mark(1, 1), "too_large", f"{size} bytes; a runtime schema has at most {MAX_BYTES}")
    loader = loader or getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _Builder(report).build(yaml.parse(text, Loader=loader))
    except yaml.reader.ReaderError as error:
        raise Refused(_mark_at(text, error.position), "yaml_syntax", "a character that YAML does not allow") from None
    except yaml.MarkedYAMLError as error:
        raise _refused(error, text) from None
    except yaml.YAMLError as error:
        raise Refused(Mark(1, 1), "yaml_syntax", str(error)) from None


def _refused(error: yaml.MarkedYAMLError, text: str) -> Refused:
    mark = error.problem_mark or error.context_mark
    where = Mark(mark.line + 1, mark.column + 1) if mark else Mark(1, 1)
    return Refused(where, "yaml_syntax", f"not YAML: {error.problem or error.context}", _why(error, where, text))


def _why(error: yaml.MarkedYAMLError, where: Mark, text: str) -> str:
    """What people usually do to cause it, or where the part begins that does not end well."""
    line = text.split("\n")[where.line - 1 : where.line]
    if line and line[0][: where.column].strip(" ").startswith("\t"):
        return "YAML is indented with blanks, not with tabs"
    if "mapping values are not allowed" in str(error.problem):
        return "text with a colon and a blank in it stands in quotes"
    begun = error.context_mark if error.problem else None
    return f"{error.context} that begins in line {begun.line + 1}" if begun and begun.line + 1 != where.line else ""


def _mark_at(text: str, position: int) -> Mark:
    before = text[:position]
    return Mark(before.count("\n") + 1, position - (before.rfind("\n") + 1) + 1)


class _Open:
    """A collection that is being read."""

    def __init__(self, node: Items | Table, anchor: str | None) -> None:
        self.node, self.anchor = node, anchor
        self.key: tuple[str, Mark] | None = None  # of a Table: the key whose value comes next
        self.merges: list[Node] = []
        self.size = 1


class _Builder:
    """Events in, tree out; a stack of open collections instead of recursion."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._stack: list[_Open] = []
        self._anchors: dict[str, tuple[Node, int]] = {}
        self._root: Node | None = None
        self._nodes = 0

    def build(self, events: Iterator[Any]) -> Node:
        for event in events:
            self._event(event, Mark(event.start_mark.line + 1, event.start_mark.column + 1))
        if self._root is None:
            raise Refused(Mark(1, 1), "yaml_syntax", "the file is empty", "begin with config:")
        return self._root

    def _event(self, event: Any, mark: Mark) -> None:
        if isinstance(event, yaml.ScalarEvent):
            self._add(self._scalar(event, mark), 1, event.anchor)
        elif isinstance(event, yaml.AliasEvent):
            self._alias(event.anchor or "", mark)
        elif isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
            self._open(event, mark)
        elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            self._close()
        elif isinstance(event, yaml.DocumentStartEvent) and self._root is not None:
            raise Refused(mark, "yaml_syntax", "a second document", "a runtime schema is one document, without ---")

    def _scalar(self, event: Any, mark: Mark) -> Scalar:
        self._refuse_tag(event, mark)
        if event.style or not event.implicit[0]:  # quoted, or tagged: text
            return Scalar(event.value, mark, event.value)
        if is_octal_trap(event.value):
            self._report(mark, "bad_value", f"{event.value} has a leading zero", "0x… is hexadecimal, 0o… octal")
            return Scalar(0, mark, event.value)  # any number will do: it is refused, and may be too long for an int
        return Scalar(resolve(event.value), mark, event.value)

    def _refuse_tag(self, event: Any, mark: Mark) -> None:
        if event.tag not in (None, "!", "tag:yaml.org,2002:str"):
            self._report(mark, "yaml_syntax", f"tag {event.tag} is not allowed", "write plain values")

    def _alias(self, anchor: str, mark: Mark) -> None:
        if anchor not in self._anchors:
            raise Refused(mark, "yaml_syntax", f"*{anchor} has no finished &{anchor} above it")
        node, size = self._anchors[anchor]
        self._add(node, size, None, mark)

    def _open(self, event: Any, mark: Mark) -> None:
        if len(self._stack) >= MAX_DEPTH:
            raise Refused(mark, "too_large", f"nested deeper than {MAX_DEPTH}")
        self._refuse_tag(event, mark)
        node = Table(mark) if isinstance(event, yaml.MappingStartEvent) else Items(mark)
        self._stack.append(_Open(node, event.anchor))

    def _close(self) -> None:
        done = self._stack.pop()
        for source in done.merges:
            self._merge(done.node, source)
        self._add(done.node, done.size, done.anchor)

    def _add(self, node: Node, size: int, anchor: str | None, mark: Mark | None = None) -> None:
        """Put a finished node (of `size` nodes) where it belongs; `mark` is that of an alias."""
        self._nodes += 1 if mark is None else size
        if self._nodes > MAX_NODES:
            raise Refused(mark or node.mark, "too_large", f"more than {MAX_NODES} values, aliases counted out")
        if anchor is not None:
            self._anchors[anchor] = (node, size)
        if not self._stack:
            self._root = node
            return
        parent = self._stack[-1]
        parent.size += size
        if isinstance(parent.node, Items):
            parent.node.items.append(node)
        elif parent.key is None:
            parent.key = self._key(node, mark or node.mark)
        else:
            self._value(parent, parent.node, node)

    def _key(self, node: Node, mark: Mark) -> tuple[str, Mark]:
        if isinstance(node, Scalar):
            return node.text, mark
        self._report(mark, "bad_type", "a key that is a list or a map", "keys are names")
        return "", mark

    @staticmethod
    def _value(parent: _Open, table: Table, node: Node) -> None:
        assert parent.key is not None
        (key, mark), parent.key = parent.key, None
        if key == "<<":
            parent.merges.append(node)
        else:
            table.add(key, Entry(mark, node))

    def _merge(self, table: Node, source: Node) -> None:
        """YAML's merge key: what `source` has and `table` does not."""
        assert isinstance(table, Table)
        for one in source.items if isinstance(source, Items) else [source]:
            if not isinstance(one, Table):
                self._report(one.mark, "bad_type", "<< merges maps only", "give an alias of a map")
                continue
            for key, entry in one.entries.items():
                table.entries.setdefault(key, entry)
