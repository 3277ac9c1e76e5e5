# SPDX-License-Identifier: Apache-2.0
"""The hash by which ROS 2 tells types apart since Iron (RIHS01): of a message's whole description (REP 2016)."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import Any

from cm.networks.ros.definitions import Field, message

_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_NESTED, _BOUNDED_STRING = 1, 21
_MANY = {"": 0, "array": 48, "bounded": 96, "sequence": 144}  # type_description_interfaces/msg/FieldType


@cache
def type_hash(name: str) -> str:
    """``RIHS01_…`` of a message."""
    described: dict[str, Any] = {}
    _collect(name, described)
    whole = {
        "type_description": described.pop(name),
        "referenced_type_descriptions": [described[other] for other in sorted(described)],
    }
    return "RIHS01_" + hashlib.sha256(json.dumps(whole, separators=(", ", ": ")).encode()).hexdigest()


def _collect(name: str, found: dict[str, Any]) -> None:
    if name in found:
        return
    fields = message(name).fields
    found[name] = {"type_name": name, "fields": [{"name": field.name, "type": _type(field)} for field in fields]}
    for field in fields:
        if "/" in field.kind:
            _collect(field.kind, found)


def _type(field: Field) -> dict[str, Any]:
    nested = field.kind if "/" in field.kind else ""
    base = _NESTED if nested else _BOUNDED_STRING if field.text_length else _IDS[field.kind]
    return {
        "type_id": base + _MANY[field.many],
        "capacity": field.length,
        "string_capacity": field.text_length,
        "nested_type_name": nested,
    }
