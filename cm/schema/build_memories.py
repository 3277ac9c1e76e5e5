# SPDX-License-Identifier: Apache-2.0
"""Memories: plain values in normal form → model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from cm.schema.build_registers import region_of
from cm.schema.context import Context, Owner, memory_key
from cm.schema.model import Access, Memory
from cm.schema.problems import KeyPath, key_path


def build_memories(data: dict[str, Any], owner: Owner, context: Context) -> Mapping[str, Memory]:
    """The memories of `data` (a configuration, module or mode), in windows and outside."""
    found: dict[str, Memory] = {}
    for path, name, window, values in _listed(data, owner.path, context):
        key = memory_key(owner.path, name)
        if name in found:
            first = key_path(context.where[key])
            context.report(path, "duplicate_name", f"memory {name} is here twice", f"the other one is {first}")
            continue
        memory = _memory(path, name, window, values, owner, context)
        if memory is not None:
            found[name] = memory
            context.where[key] = path
    return MappingProxyType(found)


def _listed(
    data: dict[str, Any], path: KeyPath, context: Context
) -> Iterator[tuple[KeyPath, str, dict[str, Any], dict[str, Any]]]:
    for index, window in enumerate(data.get("mmio", ())):
        here: KeyPath = (*path, "mmio", index)
        if "registers" not in window and "memories" not in window:
            context.report(here, "missing_key", "registers is missing", "registers or memories, or both")
        for name, values in window.get("memories", {}).items():
            yield (*here, "memories", name), name, window, values
    for name, values in data.get("memories", {}).items():
        yield (*path, "memories", name), name, {}, values


def _memory(
    path: KeyPath, name: str, window: dict[str, Any], values: dict[str, Any], owner: Owner, context: Context
) -> Memory | None:
    base = values.get("base_address", window.get("base_address"))
    if base is None:
        context.report(path, "missing_key", "base_address is missing", "or put the memory into a window under mmio")
        return None
    return Memory(
        name=name,
        base_address=int(base),
        size=int(values["size"]),
        offset=int(values.get("offset", 0)),
        access=Access(values.get("access", "rw")),
        dtype=values.get("dtype", "uint32"),
        shape=tuple(int(length) for length in values["shape"]) if "shape" in values else None,
        region=region_of(values, window, owner),
        doc=values.get("doc", ""),
    )
