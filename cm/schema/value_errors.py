# SPDX-License-Identifier: Apache-2.0
"""fastjsonschema's one error at a time → all of them, in words of the field."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

from cm.schema.problems import KeyPath, did_you_mean
from cm.schema.reader import resolve

MAX_FINDINGS = 100
_KINDS = {
    "object": "a map",
    "array": "a list",
    "string": "text",
    "integer": "an integer",
    "number": "a number",
    "boolean": "true or false",
}
_NAME = re.compile(r"\^\[A-Za-z_\]\[A-Za-z0-9(?P<signs>[_/-]+)\]\{0,(?P<more>\d+)\}\$")  # as our schemas write it
_LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")
_RANGES = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")


class Finding(NamedTuple):
    """A value that breaks the schema."""

    path: KeyPath
    code: str
    message: str
    hint: str


def findings(data: Any, validate: Callable[[Any], Any]) -> list[Finding]:
    """Everything that `validate` refuses about `data`; what it refuses is cut out of `data`."""
    from fastjsonschema import JsonSchemaValueException

    found: list[Finding] = []
    while len(found) < MAX_FINDINGS:
        try:
            validate(data)
            break
        except JsonSchemaValueException as error:
            path = _path(data, error.path[1:])
            found.append(_finding(path, error))
            if not _cut(data, path):
                break
    return found


def _path(data: Any, steps: list[str]) -> KeyPath:
    """fastjsonschema names indices as text; `data` tells them from keys."""
    path: list[str | int] = []
    for text in steps:
        step = int(text) if isinstance(data, list) else text
        path.append(step)
        data = data[step]
    return tuple(path)


def _cut(data: Any, path: KeyPath) -> bool:
    """Delete the innermost entry of a map on `path`; an index must not shift those after it."""
    owner: Any = None
    key: str | int = ""
    for step in path:
        if isinstance(data, dict):
            owner, key = data, step
        data = data[step]
    if owner is None:
        return False
    del owner[key]
    return True


def _finding(path: KeyPath, error: Any) -> Finding:
    rule, value, wanted = error.rule, error.value, error.rule_definition
    about = description(error.definition)
    if rule == "type":
        hint = "write it without quotes" if _is_quoted_number(value, wanted) else about
        return Finding(path, "bad_type", f"expected {_kinds(wanted)}, found {_found(value)}", hint)
    if rule == "enum":
        code = "bad_dtype" if path[-1] == "dtype" else "bad_value"
        choices = ", ".join(map(str, wanted))
        return Finding(path, code, f"{_found(value)} is not one of {choices}", _near(value, wanted, about))
    if rule in _RANGES:
        return Finding(path, "value_range", f"{value} is out of range", joined(_limit(rule, wanted), about))
    if rule in ("minItems", "maxItems"):
        limit = f"at {'least' if rule == 'minItems' else 'most'} {wanted} items"
        return Finding(path, "bad_value", f"{len(value)} items", joined(limit, about))
    if rule == "minProperties":
        return Finding(path, "bad_value", "nothing is in it", about)
    if rule == "maxProperties":
        return Finding(path, "too_large", f"{len(value)} entries", joined(f"at most {wanted}", about))
    hint = joined(about, name_form(wanted)) if rule == "pattern" else about
    return Finding(path, "bad_value", f"{_found(value)} does not fit", hint)


def name_form(pattern: str) -> str:
    """A name's pattern in words; empty for other patterns, whose description says what they look like."""
    name = _NAME.fullmatch(pattern)
    if name is None:
        return ""
    signs = [*name["signs"]]
    listed = f"{', '.join(['letters, digits', *signs[:-1]])} and {signs[-1]}"
    return f"{listed}, beginning with a letter or _, at most {int(name['more']) + 1} characters"


def _is_quoted_number(value: object, wanted: str | list[str]) -> bool:
    return wanted in ("integer", "number") and isinstance(value, str) and type(resolve(value)) in (int, float)


def description(schema: dict[str, Any]) -> str:
    """What a schema says of a value, without the links that its page has."""
    return _LINK.sub(r"\1", schema.get("description", "")).rstrip(".")


def joined(*parts: str) -> str:
    """The parts of a hint, without empty ones."""
    return "; ".join(part for part in parts if part)


def _near(value: object, wanted: list[Any], about: str) -> str:
    hint = did_you_mean(str(value), map(str, wanted))
    return hint if hint.startswith("did") else about


def _kinds(wanted: str | list[str]) -> str:
    return " or ".join(_KINDS[kind] for kind in ([wanted] if isinstance(wanted, str) else wanted))


def _limit(rule: str, limit: float) -> str:
    words = {"minimum": "at least", "maximum": "at most", "exclusiveMinimum": "more than"}
    return f"{words.get(rule, 'less than')} {limit}"


def _found(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (dict, list)):
        return "a map" if isinstance(value, dict) else "a list"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
