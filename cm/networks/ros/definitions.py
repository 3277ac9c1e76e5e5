# SPDX-License-Identifier: Apache-2.0
"""ROS 2 interfaces as data: what .msg, .srv and .action files define, looked up by name.

Names are as ROS writes them: ``sensor_msgs/msg/Image``, ``cm_interfaces/srv/Plan_Request``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

from cm.errors import NotFound
from cm.networks.ros.own import OWN
from cm.networks.ros.standard import STANDARD

PRIMITIVES = frozenset(
    ("bool", "byte", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
)
_ALIASES = {"char": "uint8", "builtin_interfaces/Time": "builtin_interfaces/msg/Time"}
_TYPE = re.compile(r"([\w/]+)(?:<=(\d+))?(?:\[(<=)?(\d+)?(\])?)?")
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
    text_length: int = 0  # of a string at most; 0: any


@dataclass(frozen=True, slots=True)
class Message:
    """A message by its name."""

    name: str
    fields: tuple[Field, ...]


@cache
def message(name: str) -> Message:
    """The message of that name; also those that rosidl derives from a service or an action: ``Plan_Request``, ``Plan``.

    Raises NotFound.
    """
    text = _texts().get(name)
    if text is None:
        raise NotFound(f"there is no ROS interface {name}")
    package = name.split("/")[0]
    fields = tuple(_field(line, package) for line in _lines(text)) or (_field(_NEEDS_ONE, package),)
    return Message(name, fields)


def dds_name(name: str) -> str:
    """``sensor_msgs/msg/Image`` as ROS's middlewares call it: ``sensor_msgs::msg::dds_::Image_``."""
    package, kind, own = name.split("/")
    return f"{package}::{kind}::dds_::{own}_"


def names() -> tuple[str, ...]:
    """Of all messages."""
    return tuple(_texts())


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
    base, text_length, bounded, length, many = found.groups()
    base = _ALIASES.get(base, base)
    if base not in PRIMITIVES and base != "string" and base.count("/") < 2:
        owner, _, own = base.rpartition("/")
        base = f"{owner or package}/msg/{own}"
    how = ""
    if many:
        how = "bounded" if bounded else "array" if length else "sequence"
    return Field(name, base, how, int(length or 0), int(text_length or 0))
