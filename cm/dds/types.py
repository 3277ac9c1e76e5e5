# SPDX-License-Identifier: Apache-2.0
"""ROS's interfaces as types of cyclonedds, by which topics are matched. Samples pass as bytes; nothing is decoded."""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types
from cyclonedds.idl.annotations import final

from cm.ros.definitions import Field, dds_name, message

_KINDS: dict[str, Any] = {
    "bool": bool, "byte": types.byte, "int8": types.int8, "uint8": types.uint8, "int16": types.int16,
    "uint16": types.uint16, "int32": types.int32, "uint32": types.uint32, "int64": types.int64,
    "uint64": types.uint64, "float32": types.float32, "float64": types.float64,
}  # fmt: skip


class Raw:
    """A sample as it came: `data` is the whole serialised message."""

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


@cache
def struct(name: str) -> Any:
    """A message's type, with its fields, for tools that show them."""
    fields = {field.name: _field(field) for field in message(name).fields}
    return final(make_idl_struct(name.rpartition("/")[2], dds_name(name), fields))


@cache
def sample_type(name: str, service: bool = False) -> Any:
    """The type of a topic, whose samples are `Raw`; of a service's topic with the header of Cyclone's RMW."""
    fields: dict[str, Any] = {"header_guid": types.uint64, "header_sequence": types.int64} if service else {}
    fields.update({field.name: _field(field) for field in message(name).fields})
    return final(make_idl_struct(name.rpartition("/")[2], dds_name(name), fields, bases=(_Bytes,)))


class _Bytes(IdlStruct):  # type: ignore[misc]
    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Raw:  # noqa: ARG003
        return Raw(data)


def _field(field: Field) -> Any:
    one: Any = _KINDS.get(field.kind)
    if one is None and field.kind == "string":
        one = types.bounded_str[field.text_length] if field.text_length else str
    elif one is None:
        one = struct(field.kind)
    if field.many == "array":
        return types.array[one, field.length]
    if field.many == "bounded":
        return types.sequence[one, field.length]
    return types.sequence[one] if field.many else one
