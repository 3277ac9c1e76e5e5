# SPDX-License-Identifier: Apache-2.0
"""What replies about registers mean."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from cm.client.errors import RequestNotFound
from cm.wire.messages.status import ConfigInfo, ErrorInfo, RegisterInfo, RegValues


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


def names(info: Iterable[RegisterInfo]) -> list[str]:
    """The names of all registers and their fields."""
    return [name for r in info for name in (r.name, *(f"{r.name}.{f.name}" for f in r.fields))]


def check(wanted: Iterable[str], info: Collection[RegisterInfo], where: str) -> None:
    """Raises RequestNotFound for the first that is no register or field of `info`, which are those `where`."""
    known = names(info)
    for name in wanted:
        if name not in known:
            import difflib  # only those who err need it

            near = difflib.get_close_matches(str(name), known, 1)
            there = ", ".join(sorted({r.name for r in info})) or "none"
            said = f"did you mean {near[0]!r}?" if near else f"there are {there}"
            raise RequestNotFound(ErrorInfo("unknown_register", f"no register {name!r} {where}; {said}"))


def not_by_attribute(name: str, value: Any) -> str:
    """The error text for ``registers.focus = 9``."""
    return (
        f"registers are written by name: registers.write({{{name!r}: {value!r}}}), or registers[{name!r}] = {value!r}"
    )
