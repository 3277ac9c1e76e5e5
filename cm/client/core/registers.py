# SPDX-License-Identifier: Apache-2.0
"""What replies about registers mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cm.wire.messages.status import ConfigInfo, RegisterInfo, RegValues


def visible(config: ConfigInfo) -> dict[str, RegisterInfo]:
    """The registers of the current mode."""
    return {r.name: r for r in config.registers if not r.modes or config.mode in r.modes}


def values(answer: RegValues) -> dict[str, int]:
    """By name."""
    return {v.name: v.value for v in answer.values}


def has(info: Mapping[str, RegisterInfo], name: object) -> bool:
    """Whether a register, or a field (``"control.enable"``), exists."""
    if not isinstance(name, str):
        return False
    register, dot, field = name.partition(".")
    found = info.get(register)
    return found is not None and (not dot or any(field == f.name for f in found.fields))


def names(info: Mapping[str, RegisterInfo]) -> list[str]:
    """The names of all registers and their fields."""
    return [name for r in info.values() for name in (r.name, *(f"{r.name}.{f.name}" for f in r.fields))]


def not_by_attribute(name: str, value: Any) -> str:
    """The error text for ``registers.focus = 9``."""
    return (
        f"registers are written by name: registers.write({{{name!r}: {value!r}}}), or registers[{name!r}] = {value!r}"
    )
