# SPDX-License-Identifier: Apache-2.0
"""The forms into which a JSON Schema is brought before use: for the walk, and for fastjsonschema."""

from __future__ import annotations

from typing import Any

_BY_WALK = ("required", "propertyNames", "patternProperties", "default", "additionalProperties")


def normal_form(schema: Any) -> Any:
    """`schema` with each ``anyOf`` replaced by its last choice; the others are kept as ``short``."""
    if isinstance(schema, list):
        return [normal_form(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    result = {key: normal_form(value) for key, value in schema.items() if key != "anyOf"}
    if "anyOf" in schema:
        *short, last = schema["anyOf"]
        result = normal_form(last) | result | {"short": short}
    return result


def for_values(schema: Any) -> Any:
    """`schema` without the rules that the walk has checked, and without defaults."""
    if isinstance(schema, list):
        return [for_values(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    keep = {key: value for key, value in schema.items() if key not in _BY_WALK or isinstance(value, dict)}
    keep.pop("patternProperties", None)
    keep.pop("propertyNames", None)
    keep.pop("short", None)
    result = {key: for_values(value) for key, value in keep.items()}
    if not (result.get("then") or result.get("else")):
        for key in ("if", "then", "else"):  # before 2.19 fastjsonschema writes an empty branch as no statement at all
            result.pop(key, None)
    return result


def without_references(schema: dict[str, Any]) -> dict[str, Any]:
    """`schema`, which is not recursive, with every definition in place of the ``$ref`` to it."""

    def inline(part: Any) -> Any:
        if isinstance(part, list):
            return [inline(item) for item in part]
        if not isinstance(part, dict):
            return part
        if "$ref" in part:
            return inline(follow(schema, part))
        return {key: inline(value) for key, value in part.items() if key != "definitions"}

    whole: dict[str, Any] = inline(schema)
    return whole


def follow(root: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """`schema`, or the definition that its ``$ref`` names in `root`."""
    while "$ref" in schema:
        steps = schema["$ref"].removeprefix("#/").split("/")
        schema = root
        for step in steps:
            schema = schema[step]
    return schema
