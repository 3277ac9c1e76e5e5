# SPDX-License-Identifier: Apache-2.0
"""Applies the JSON Schema: a tree in any accepted form → plain values in normal form.

`Structure` walks the tree along the schema. It brings the accepted short forms (a list of one-key maps, a list of
names, a single name) into the normal form, reports keys that are unknown, missing or written twice, and leaves types
and ranges to fastjsonschema.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cm.schema.compiled import ready
from cm.schema.paper_listing import fold, lift_overlays, windows
from cm.schema.problems import KeyPath, did_you_mean
from cm.schema.schema_forms import follow, for_values, normal_form, without_references
from cm.schema.tree import Entry, Items, Mark, Node, Scalar, Table, plain
from cm.schema.value_errors import Finding, description, findings, joined, name_form

SCHEMA_FILE = Path(__file__).parent / "data" / "runtime.schema.json"
_WINDOW = "#/definitions/window"
_WHOLE = {"project": "this is a build schema: cm build check", "config": "this is a runtime schema: cm config check"}
_ELSEWHERE = {
    "relocatable": "it belongs to a module of the build schema: cm build run makes a bitstream for each of its regions"
}

Report = Callable[[Mark, KeyPath, str, str, str], None]  # position, path, code, message, hint


class Structure:
    """A JSON Schema, compiled when it is first needed."""

    def __init__(self, schema: dict[str, Any], good: Callable[[Any], Any] | None = None) -> None:
        """`good`: a validator of values made before (`cm.schema.compiled`), which raises ValueError."""
        self._normal: dict[str, Any] = normal_form(schema)
        self._good = good
        self._explain: Callable[[Any], Any] | None = None

    def fit(self, root: Node, report: Report) -> Node:
        """`root` in normal form, without what is unknown; everything odd about keys is reported."""
        return _Walk(self._normal, report).node(root, self._normal, ())

    def values(self, root: Node) -> list[Finding]:
        """What is wrong with the values of a tree in normal form.

        Two validators: one that is compiled quickly says whether anything is wrong; fastjsonschema
        (2.16 at least) gives the path of an error only where no ``$ref`` lies on it, so that what is
        wrong is found by a second, without any, which takes longer to compile.
        """
        data = plain(root)
        if self._good is None:
            self._good = _compile(for_values(self._normal))
        try:
            self._good(data)
        except ValueError:
            if self._explain is None:
                self._explain = _compile(without_references(for_values(self._normal)))
            return findings(data, self._explain)
        return []

    def usable(self, root: Node, wrong: Iterable[KeyPath]) -> Node | None:
        """What is left of a tree in normal form without the values at `wrong`, and all that lacks a required key."""
        for path in wrong:
            _cut(root, path)
        return self._complete(root, self._normal)

    def _complete(self, node: Node, schema: dict[str, Any]) -> Node | None:
        shape = follow(self._normal, schema)
        if shape.get("type") == "object" and not isinstance(node, Table):
            return None  # the whole: any other is cut
        if isinstance(node, Items):
            kept = [self._complete(item, shape["items"]) for item in node.items]
            return Items(node.mark, [item for item in kept if item is not None])
        if isinstance(node, Scalar):
            return node
        result = Table(node.mark)
        for key, entry in node.entries.items():
            below = shape["properties"][key] if "properties" in shape else shape["additionalProperties"]
            part = self._complete(entry.node, below)
            if part is not None:
                result.add(key, Entry(entry.mark, part))
        return result if result.entries.keys() >= set(shape.get("required", ())) else None


def _cut(root: Node, path: KeyPath) -> None:
    """Take the innermost entry of a map on `path` out, as `findings` does with plain values."""
    owner, key, node = None, "", root
    for step in path:
        if isinstance(node, Table) and isinstance(step, str):
            if step not in node.entries:
                return  # with what is around it
            owner, key, node = node, step, node.entries[step].node
        elif isinstance(node, Items) and isinstance(step, int):
            node = node.items[step]
    if owner is not None:
        del owner.entries[key]


def load_structure() -> Structure:
    """The structure of the runtime schema, from the file that comes with the package."""
    text = SCHEMA_FILE.read_bytes()
    return Structure(json.loads(text), ready(text))


def _compile(schema: dict[str, Any]) -> Callable[[Any], Any]:
    import fastjsonschema

    validate: Callable[[Any], Any] = fastjsonschema.compile(schema)
    return validate


class _Walk:
    def __init__(self, root: dict[str, Any], report: Report) -> None:
        self._root, self._report = root, report

    def node(self, node: Node, schema: dict[str, Any], path: KeyPath) -> Node:
        shape = self._resolve(schema)
        if shape.get("type") == "object":
            return self._object(node, shape, path)
        if shape.get("type") == "array":
            return self._array(node, shape, path)
        return node

    def _resolve(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Follow ``$ref``; what a choice was made from stays beside it."""
        short = schema.get("short", [])
        schema = follow(self._root, schema)
        return schema | {"short": short} if short else schema

    def _object(self, node: Node, shape: dict[str, Any], path: KeyPath) -> Node:
        table = self._table(node, shape)
        if not isinstance(table, Table):
            return node
        for key, mark in table.duplicates:
            code = "duplicate_key" if "properties" in shape else "duplicate_name"
            first = table.entries.get(key)  # None: moved elsewhere, as overlays are
            hint = f"it is in line {first.mark.line} already" if first else "keep one of them"
            self._report(mark, (*path, key), code, f"{key[:80]} is here again", hint)
        if "properties" in shape:
            return self._keyed(table, shape, path)
        return self._named(table, shape, path)

    def _table(self, node: Node, shape: dict[str, Any]) -> Node:
        """`node` as a map, where one of the short forms says how."""
        short = [choice.get("type") for choice in shape.get("short", ())]
        if isinstance(node, Items):
            return fold(node, names="array" in short)
        if isinstance(node, Scalar) and node.value is None:
            return Table(node.mark)
        if isinstance(node, Scalar) and _json_type(node.value) in short:
            return Table(node.mark, {next(iter(shape.get("required", ("",)))): Entry(node.mark, node)})
        return node

    def _keyed(self, table: Table, shape: dict[str, Any], path: KeyPath) -> Table:
        properties = shape["properties"]
        if "overlays" in properties:
            table = lift_overlays(table)
        result = Table(table.mark)
        for key, entry in table.entries.items():
            if key in properties:
                result.add(key, Entry(entry.mark, self.node(entry.node, properties[key], (*path, key))))
            elif not any(re.search(pattern, key) for pattern in shape.get("patternProperties", ())):
                hint = ("" if path else _WHOLE.get(key)) or _ELSEWHERE.get(key) or did_you_mean(key, properties)
                self._report(entry.mark, (*path, key), "unknown_key", f"unknown key {key[:80]!r}", hint)
        for key in shape.get("required", ()):
            if key not in table.entries:
                hint = description(self._resolve(properties[key]))
                self._report(table.mark, path, "missing_key", f"{key} is missing", hint)
        return result

    def _named(self, table: Table, shape: dict[str, Any], path: KeyPath) -> Table:
        names = self._resolve(shape.get("propertyNames", {}))
        pattern = names.get("pattern", ".+")
        result = Table(table.mark)
        for name, entry in table.entries.items():
            if re.fullmatch(pattern.strip("^$"), name):
                node = self.node(entry.node, shape["additionalProperties"], (*path, name))
                result.add(name, Entry(entry.mark, node))
            else:
                hint = joined(name_form(pattern), description(names))
                self._report(entry.mark, (*path, name), "bad_name", f"{name[:80]!r} is not a name", hint)
        return result

    def _array(self, node: Node, shape: dict[str, Any], path: KeyPath) -> Node:
        if isinstance(node, Scalar) and node.value is None:
            return Items(node.mark)
        if shape["items"].get("$ref") == _WINDOW:
            node = windows(node)
        elif isinstance(node, Scalar) and isinstance(node.value, str) and self._takes_text(shape["items"]):
            node = Items(node.mark, [node])
        if not isinstance(node, Items):
            return node
        items = [self.node(item, shape["items"], (*path, index)) for index, item in enumerate(node.items)]
        return Items(node.mark, items)

    def _takes_text(self, items: dict[str, Any]) -> bool:
        shape = self._resolve(items)
        return any(choice.get("type") == "string" for choice in (shape, *shape.get("short", ())))


def _json_type(value: object) -> str:
    return {str: "string", int: "integer"}.get(type(value), "")
