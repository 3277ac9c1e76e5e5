# SPDX-License-Identifier: Apache-2.0
"""Registers and their fields: plain values in normal form → model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from cm.schema.context import STATIC, Context, Owner
from cm.schema.model import Access, BitField, Register
from cm.schema.problems import KeyPath, key_path


def build_registers(data: dict[str, Any], owner: Owner, context: Context) -> Mapping[str, Register]:
    """The registers of `data` (a configuration, module or mode), in windows and outside."""
    found: dict[str, Register] = {}
    for path, name, window, values in _listed(data, owner.path):
        if name in found:
            first = key_path(context.where[owner.path, name])
            context.report(path, "duplicate_name", f"register {name} is here twice", f"the other one is {first}")
            continue
        register = _register(path, name, window, values, owner, context)
        if register is not None:
            found[name] = register
            context.where[owner.path, name] = path
    return MappingProxyType(found)


def _listed(data: dict[str, Any], path: KeyPath) -> Iterator[tuple[KeyPath, str, dict[str, Any], dict[str, Any]]]:
    for index, window in enumerate(data.get("mmio", ())):
        for name, values in window.get("registers", {}).items():
            yield (*path, "mmio", index, "registers", name), name, window, values
    for name, values in data.get("registers", {}).items():
        yield (*path, "registers", name), name, {}, values


def _register(
    path: KeyPath, name: str, window: dict[str, Any], values: dict[str, Any], owner: Owner, context: Context
) -> Register | None:
    base = values.get("base_address", window.get("base_address"))
    if base is None:
        context.report(path, "missing_key", "base_address is missing", "or put the register into a window under mmio")
        return None
    return Register(
        name=name,
        base_address=int(base),
        offset=int(values["offset"]),
        width=int(values.get("width", 32)),
        access=Access(values.get("access", "rw")),
        default=_integer(values.get("default")),
        reset=_integer(values.get("reset")),
        minimum=_integer(values.get("min")),
        maximum=_integer(values.get("max")),
        fields=_fields(values.get("fields", {}), (*path, "fields"), context),
        region=region_of(values, window, owner),
        volatile=values.get("volatile", False),
        doc=values.get("doc", ""),
    )


def region_of(values: dict[str, Any], window: dict[str, Any], owner: Owner) -> str | None:
    """The region of what stands in a window: its own, else the window's, else its owner's; None: the static part."""
    name: str | None = values.get("region", window.get("region", owner.region))
    return None if name == STATIC else name


def _integer(value: float | None) -> int | None:
    """JSON Schema counts 1.0 as an integer; the model does not."""
    return None if value is None else int(value)


def _fields(data: dict[str, Any], path: KeyPath, context: Context) -> Mapping[str, BitField]:
    found: dict[str, BitField] = {}
    for name, values in data.items():
        bits = _bits(values, (*path, name), context)
        if bits is not None:
            names = {word: int(value) for word, value in values.get("values", {}).items()}
            found[name] = BitField(name, *bits, values.get("doc", ""), MappingProxyType(names))
    return MappingProxyType(found)


def _bits(values: dict[str, Any], path: KeyPath, context: Context) -> tuple[int, int] | None:
    """Lowest bit and width, from ``bits: "7:4"`` or from ``lsb`` and ``width``."""
    if ("bits" in values) == ("lsb" in values) or ("bits" in values and "width" in values):
        context.report(path, "missing_key", "where is the field?", "either bits, or lsb and width")
        return None
    if "lsb" in values:
        return int(values["lsb"]), int(values.get("width", 1))
    ends = [int(end) for end in str(values["bits"]).removesuffix(".0").split(":")]
    high, low = ends[0], ends[-1]
    if high < low:
        context.report((*path, "bits"), "bad_value", f"{high} is below {low}", f'highest bit first: "{low}:{high}"')
        return None
    return low, high - low + 1
