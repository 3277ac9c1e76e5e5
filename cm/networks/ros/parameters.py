# SPDX-License-Identifier: Apache-2.0
"""Registers as the node's parameters: ``registers.focus``, and their fields: ``fields.led.blink``.

A parameter's name must not begin another's: ``ros2 param dump`` turns them into maps.

The values that a register may hold are the parameter's range; a read-only register is a read-only parameter. Parameters
are signed: a value of 64 bits whose highest bit is set shows as a negative number, and is written as one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from cm.errors import CmError
from cm.networks.bridge.commands import Commands
from cm.networks.bridge.records import Caller, ConfigRecord
from cm.networks.ros import messages
from cm.networks.ros.transport import Publisher, Values
from cm.wire.messages.status import FieldInfo, RegisterInfo, RegValues

_REGISTERS, _FIELDS = "registers.", "fields."
_NOT_SET, _INTEGER = 0, 2  # rcl_interfaces/msg/ParameterType
_TOP, _WHOLE = 1 << 63, 1 << 64


class Parameters:
    """Answers of the parameter services, over the registers of the mode that runs."""

    def __init__(self, commands: Commands, node: str, guest: str = "") -> None:
        self._commands = commands
        self._node = node
        self._caller = Caller(guest)
        self._known: Mapping[str, tuple[RegisterInfo, FieldInfo | None]] = {}

    def take(self, record: ConfigRecord) -> None:
        """Take the registers of another mode."""
        known: dict[str, tuple[RegisterInfo, FieldInfo | None]] = {}
        for register in record.registers:
            known[_REGISTERS + register.name] = (register, None)
            known.update({f"{_FIELDS}{register.name}.{f.name}": (register, f) for f in register.fields})
        self._known = known

    def all(self) -> Mapping[str, tuple[str, Callable[[dict[str, Any]], Values]]]:
        """The services that every ROS node has for its parameters."""
        kind = "rcl_interfaces/srv/"

        def set_each(request: dict[str, Any]) -> Values:
            return {"results": [self._set([parameter]) for parameter in request["parameters"]]}

        def set_atomically(request: dict[str, Any]) -> Values:
            return {"result": self._set(request["parameters"])}

        return {
            "list_parameters": (f"{kind}ListParameters", self.list_names),
            "describe_parameters": (f"{kind}DescribeParameters", self.describe),
            "get_parameter_types": (f"{kind}GetParameterTypes", self.types),
            "get_parameters": (f"{kind}GetParameters", self.get),
            "set_parameters": (f"{kind}SetParameters", set_each),
            "set_parameters_atomically": (f"{kind}SetParametersAtomically", set_atomically),
        }

    def list_names(self, request: dict[str, Any]) -> Values:
        prefixes, depth = request["prefixes"], request["depth"]
        names = [name for name in self._known if _below(name, prefixes, depth)]
        return {"result": {"names": names, "prefixes": sorted({name.rpartition(".")[0] for name in names})}}

    def describe(self, request: dict[str, Any]) -> Values:
        return {"descriptors": [self._described(name) for name in request["names"]]}

    def types(self, request: dict[str, Any]) -> Values:
        return {"types": bytes(_INTEGER if name in self._known else _NOT_SET for name in request["names"])}

    def get(self, request: dict[str, Any]) -> Values:
        """GetParameters: what the registers hold now; "not set" for those that cannot be read, or do not exist."""
        asked = [name for name in request["names"] if name in self._known and self._known[name][0].access != "wo"]
        held = self._held(asked)
        return {"values": [_value(held.get(name)) for name in request["names"]]}

    def _held(self, names: list[str]) -> dict[str, int]:
        """Read one by one if they cannot be read together: a region may be isolated at the moment."""
        if not names:
            return {}
        try:
            values = self._commands.read_registers(self._caller, *map(_register, names)).values
        except CmError:
            return {} if len(names) == 1 else {n: v for name in names for n, v in self._held([name]).items()}
        return {name: value.value for name, value in zip(names, values, strict=True)}

    def event(self, values: RegValues, publisher: Publisher) -> None:
        """Tell ``/parameter_events`` of registers that any client wrote."""
        changed = [{"name": _REGISTERS + v.name, "value": _value(v.value)} for v in values.values]
        changed += [
            {"name": f"{_FIELDS}{v.name}.{name}", "value": _value(x)} for v in values.values for name, x in v.fields
        ]
        stamp = messages.time(time.time_ns())
        publisher.write({"stamp": stamp, "node": self._node, "changed_parameters": changed})

    def _set(self, parameters: Any) -> Values:
        """All are checked before the first is written."""
        writes: dict[str, int | str] = {}
        for parameter in parameters:
            name, value = parameter["name"], parameter["value"]
            if name not in self._known:
                return {"successful": False, "reason": f"there is no parameter {name} in this mode"}
            if value["type"] != _INTEGER:
                return {"successful": False, "reason": f"{name} takes an integer"}
            width = self._known[name][0].width
            raw = value["integer_value"]
            writes[_register(name)] = raw % _WHOLE if width == 64 and raw < 0 else raw
        try:
            self._commands.write_registers(self._caller, writes)
        except CmError as error:
            return {"successful": False, "reason": str(error)}
        return {"successful": True}

    def _described(self, name: str) -> Values:
        known = self._known.get(name)
        if known is None:
            return {"name": name, "type": _NOT_SET}
        register, field = known
        first, last = _bounds(register, field)
        choices = ", ".join(f"{text} = {number}" for text, number in field.values) if field is not None else ""
        return {
            "name": name,
            "type": _INTEGER,
            "description": field.doc if field is not None else register.doc,
            "additional_constraints": choices or f"{register.access}, {register.width} bits at {register.address:#x}",
            "read_only": register.access == "ro" or "registers" not in self._commands.writes,
            "integer_range": [{"from_value": first, "to_value": last, "step": 1}],
        }


def _register(name: str) -> str:
    """The name that the manager knows: ``led``, ``led.blink``."""
    return name.partition(".")[2]


def _bounds(register: RegisterInfo, field: FieldInfo | None) -> tuple[int, int]:
    """The bounds as signed numbers; all values if all 64 bits are used."""
    if field is not None:
        first, last = 0, (1 << field.width) - 1
    else:
        first = register.minimum or 0
        last = (1 << register.width) - 1 if register.maximum is None else register.maximum
    return (first, last) if last < _TOP else (-_TOP, _TOP - 1)


def _value(value: int | None) -> Values:
    if value is None:
        return {"type": _NOT_SET}
    return {"type": _INTEGER, "integer_value": value - _WHOLE if value >= _TOP else value}


def _below(name: str, prefixes: Any, depth: int) -> bool:
    """As in rclcpp: `depth` counts the parts after the prefix, 0 means any number."""
    if not prefixes:
        return depth == 0 or name.count(".") < depth
    return any(
        name == prefix or (name.startswith(prefix + ".") and (depth == 0 or name[len(prefix) + 1 :].count(".") < depth))
        for prefix in prefixes
    )
