# SPDX-License-Identifier: Apache-2.0
"""ROS 2 interfaces as data: what .msg, .srv and .action files define, looked up by name, and the hashes of types.

Names are as ROS writes them: ``sensor_msgs/msg/Image``, ``cm_interfaces/srv/Plan_Request``. `STANDARD` are the fields
of ROS's own interfaces that the node uses, as its files have them (tests compare them).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

from cm.errors import NotFound
from cm.networks.rmw_zenoh._cm_interfaces import OWN  # of ros2/cm_interfaces, by setup.py

STANDARD = MappingProxyType(
    {
        "action_msgs/msg/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp",
        "action_msgs/msg/GoalStatus": "GoalInfo goal_info\nint8 status",
        "action_msgs/msg/GoalStatusArray": "GoalStatus[] status_list",
        "action_msgs/srv/CancelGoal": "GoalInfo goal_info\n---\nint8 return_code\nGoalInfo[] goals_canceling",
        "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
        "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status",
        "diagnostic_msgs/msg/DiagnosticStatus": (
            "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values"
        ),
        "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
        "rcl_interfaces/msg/FloatingPointRange": "float64 from_value\nfloat64 to_value\nfloat64 step",
        "rcl_interfaces/msg/IntegerRange": "int64 from_value\nint64 to_value\nuint64 step",
        "rcl_interfaces/msg/ListParametersResult": "string[] names\nstring[] prefixes",
        "rcl_interfaces/msg/Parameter": "string name\nParameterValue value",
        "rcl_interfaces/msg/ParameterDescriptor": (
            "string name\nuint8 type\nstring description\nstring additional_constraints\nbool read_only\n"
            "bool dynamic_typing\nFloatingPointRange[<=1] floating_point_range\nIntegerRange[<=1] integer_range"
        ),
        "rcl_interfaces/msg/ParameterEvent": (
            "builtin_interfaces/Time stamp\nstring node\nParameter[] new_parameters\nParameter[] changed_parameters\n"
            "Parameter[] deleted_parameters"
        ),
        "rcl_interfaces/msg/ParameterValue": (
            "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\nstring string_value\n"
            "byte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\n"
            "float64[] double_array_value\nstring[] string_array_value"
        ),
        "rcl_interfaces/msg/SetParametersResult": "bool successful\nstring reason",
        "rcl_interfaces/srv/DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors",
        "rcl_interfaces/srv/GetParameterTypes": "string[] names\n---\nuint8[] types",
        "rcl_interfaces/srv/GetParameters": "string[] names\n---\nParameterValue[] values",
        "rcl_interfaces/srv/ListParameters": "string[] prefixes\nuint64 depth\n---\nListParametersResult result",
        "rcl_interfaces/srv/SetParameters": "Parameter[] parameters\n---\nSetParametersResult[] results",
        "rcl_interfaces/srv/SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result",
        "sensor_msgs/msg/CameraInfo": (
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
            "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi"
        ),
        "sensor_msgs/msg/Image": (
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
            "uint8[] data"
        ),
        "sensor_msgs/msg/RegionOfInterest": (
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"
        ),
        "service_msgs/msg/ServiceEventInfo": (
            "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
        ),
        "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
        "std_msgs/msg/String": "string data",
        "unique_identifier_msgs/msg/UUID": "uint8[16] uuid",
    }
)


_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_ALIASES = {"char": "uint8", "builtin_interfaces/Time": "builtin_interfaces/msg/Time"}
_TYPE = re.compile(r"([\w/]+)(?:\[(<=)?(\d+)?(\])?)?")
_NEEDS_ONE = "uint8 structure_needs_at_least_one_member"  # what rosidl puts where a message has no field
_EVENT_INFO = "service_msgs/msg/ServiceEventInfo"
_UUID, _TIME = "unique_identifier_msgs/msg/UUID", "builtin_interfaces/msg/Time"


@dataclass(frozen=True, slots=True)
class Field:
    """A field: `kind` is a primitive, ``string``, or the name of a message.

    `many`: empty for one value, ``array`` for exactly `length`, ``bounded`` for at most `length`, ``sequence`` for any.
    """

    name: str
    kind: str
    many: str = ""
    length: int = 0


@cache
def fields_of(name: str) -> tuple[Field, ...]:
    """Those of a message; also of what rosidl derives from a service or an action: ``Plan_Request``, ``Plan``.

    Raises NotFound.
    """
    text = _texts().get(name)
    if text is None:
        raise NotFound(f"there is no ROS interface {name}")
    package = name.split("/")[0]
    return tuple(_field(line, package) for line in _lines(text)) or (_field(_NEEDS_ONE, package),)


def dds_name(name: str) -> str:
    """``sensor_msgs/msg/Image`` as ROS's middlewares call it: ``sensor_msgs::msg::dds_::Image_``."""
    package, kind, own = name.split("/")
    return f"{package}::{kind}::dds_::{own}_"


@cache
def _texts() -> Mapping[str, str]:
    found: dict[str, str] = {}
    for name, text in {**STANDARD, **OWN}.items():
        found.update(_parts(name, text))
    return found


def _parts(name: str, text: str) -> Iterator[tuple[str, str]]:
    kind = name.split("/")[1]
    if kind == "msg":
        yield name, text
        return
    parts = re.split(r"^---$", text, flags=re.MULTILINE)
    if kind == "srv":
        yield from zip((f"{name}_Request", f"{name}_Response"), parts, strict=True)
        yield from _service(name)
        return
    goal, result, feedback = (f"{name}_{part}" for part in ("Goal", "Result", "Feedback"))
    yield from zip((goal, result, feedback), parts, strict=True)
    yield f"{name}_SendGoal_Request", f"{_UUID} goal_id\n{goal} goal"
    yield f"{name}_SendGoal_Response", f"bool accepted\n{_TIME} stamp"
    yield f"{name}_GetResult_Request", f"{_UUID} goal_id"
    yield f"{name}_GetResult_Response", f"int8 status\n{result} result"
    yield f"{name}_FeedbackMessage", f"{_UUID} goal_id\n{feedback} feedback"
    yield from _service(f"{name}_SendGoal")
    yield from _service(f"{name}_GetResult")


def _service(name: str) -> Iterator[tuple[str, str]]:
    """A service has a hash of its own: it is described by its request, its reply, and an event with both."""
    asked, replied, event = f"{name}_Request", f"{name}_Response", f"{name}_Event"
    yield event, f"{_EVENT_INFO} info\n{asked}[<=1] request\n{replied}[<=1] response"
    yield name, f"{asked} request_message\n{replied} response_message\n{event} event_message"


def _lines(text: str) -> Iterator[str]:
    """Lines of fields: no comments, no constants."""
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if words and "=" not in "".join(words[1:]):
            yield " ".join(words[:2])


def _field(line: str, package: str) -> Field:
    kind, name = line.split()
    found = _TYPE.fullmatch(kind)
    assert found is not None, line
    base, bounded, length, many = found.groups()
    base = _ALIASES.get(base, base)
    if base not in _IDS and base.count("/") < 2:
        owner, _, own = base.rpartition("/")
        base = f"{owner or package}/msg/{own}"
    how = ""
    if many:
        how = "bounded" if bounded else "array" if length else "sequence"
    return Field(name, base, how, int(length or 0))


def definition(name: str) -> str:
    """The text of a message and of all that it holds, as MCAP's encoding ``ros2msg`` and rosbag2 have it."""
    found = [name]
    for one in found:  # grows
        found += [f.kind for f in fields_of(one) if f.kind.count("/") == 2 and f.kind not in found]
    texts = [_texts()[one] for one in dict.fromkeys(found)]
    own, *others = zip(dict.fromkeys(found), texts, strict=True)
    return "\n".join([own[1], *(f"{'=' * 80}\nMSG: {one.replace('/msg/', '/')}\n{text}" for one, text in others)])


_NESTED = 1
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
    fields = fields_of(name)
    found[name] = {"type_name": name, "fields": [{"name": field.name, "type": _type(field)} for field in fields]}
    for field in fields:
        if "/" in field.kind:
            _collect(field.kind, found)


def _type(field: Field) -> dict[str, Any]:
    nested = field.kind if "/" in field.kind else ""
    base = _NESTED if nested else _IDS[field.kind]
    return {
        "type_id": base + _MANY[field.many],
        "capacity": field.length,
        "string_capacity": 0,
        "nested_type_name": nested,
    }
