# SPDX-License-Identifier: Apache-2.0
"""Plain values to messages of rclpy and back, and the classes of interfaces by their names."""

from __future__ import annotations

import array
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

_ACTION_PARTS = {
    "SendGoal": ("Impl", "SendGoalService"),
    "GetResult": ("Impl", "GetResultService"),
    "FeedbackMessage": ("Impl", "FeedbackMessage"),
}


@cache
def interface(name: str) -> Any:
    """The class of ``sensor_msgs/msg/Image``, or of a part of an action, ``…/action/ChangeMode_SendGoal``."""
    package, kind, own = name.split("/")
    module = import_module(f"{package}.{kind}")
    if kind != "action":
        return getattr(module, own)
    action, _, part = own.partition("_")
    found = getattr(module, action)
    for step in _ACTION_PARTS[part]:
        found = getattr(found, step)
    return found


def fill(message: Any, values: Any) -> Any:
    """`message` with these values; fields that are left out stay as they are."""
    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        if name in kinds:
            setattr(message, name, _converted(getattr(message, name), kinds[name], value))
    return message


def _converted(old: Any, kind: str, value: Any) -> Any:
    if kind in ("octet", "byte"):
        return bytes((value,))
    if isinstance(old, array.array):  # a sequence of numbers; assigning anything else is checked one by one
        return _numbers(old.typecode, value)
    if isinstance(old, np.ndarray):  # an array of numbers
        return np.frombuffer(value, old.dtype) if isinstance(value, (bytes, memoryview)) else np.array(value, old.dtype)
    if isinstance(old, list):
        return [_element(kind, one) for one in value]
    return fill(old, value) if hasattr(old, "get_fields_and_field_types") else value


def _numbers(code: str, value: Any) -> array.array[Any]:
    if isinstance(value, (bytes, bytearray, memoryview)):
        found = array.array(code)
        found.frombytes(value)
        return found
    return array.array(code, value)


def _element(kind: str, value: Any) -> Any:
    """`kind`: ``sequence<cm_interfaces/Region>``."""
    inner = kind.partition("<")[2].rpartition(">")[0].partition(",")[0] if "<" in kind else kind.partition("[")[0]
    if "/" not in inner:
        return bytes((value,)) if inner in ("octet", "byte") else value
    package, _, own = inner.partition("/")
    return fill(interface(f"{package}/msg/{own}")(), value)


def values(message: Any) -> Any:
    """A message as plain values; sequences of bytes are memory of the message."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: values(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if isinstance(message, array.array):
        return memoryview(message).cast("B") if message.typecode == "B" else list(message)
    if isinstance(message, np.ndarray):
        return message.tobytes() if message.dtype == np.uint8 else message.tolist()
    if isinstance(message, (list, tuple)):
        return [values(one) for one in message]
    return message[0] if isinstance(message, bytes) and len(message) == 1 else message
