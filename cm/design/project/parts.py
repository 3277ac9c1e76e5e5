# SPDX-License-Identifier: Apache-2.0
"""Small parts of a build schema: connections, registers, streams of modes, values of macros."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cm.design.project.model import ConnectionSpec, FieldSpec, ModeStreamSpec, RegisterSpec, SwitchSpec
from cm.schema.model import Access


def connection(spec: dict[str, Any]) -> ConnectionSpec:
    """An interface of a region."""
    spec = dict(spec)
    shape, single = spec.pop("shape", None), spec.pop("pin", None)
    pins = {name.lower(): tuple(given) for name, given in (spec.pop("pins", None) or {}).items()}
    if single:
        pins[""] = tuple(single)
    return ConnectionSpec(**spec, shape=tuple(shape) if shape else None, pins=pins)


def switch(spec: dict[str, Any], clock: str) -> SwitchSpec:
    """The switch between regions; `clock` is the default one."""
    ends = {
        side: {name: replace(connection(value or {}), stream=name) for name, value in (spec.get(side) or {}).items()}
        for side in ("inputs", "outputs")
    }
    return SwitchSpec(spec.get("clock", clock), **ends)


def mode_stream(spec: dict[str, Any]) -> ModeStreamSpec:
    """A stream in a mode."""
    shape = spec.get("shape")
    return ModeStreamSpec(tuple(shape) if shape else None, spec.get("dtype"))


def registers(spec: dict[str, Any]) -> dict[str, RegisterSpec]:
    """Registers by name."""
    return {name: _register(name, value) for name, value in (spec.get("registers") or {}).items()}


def _register(name: str, spec: dict[str, Any]) -> RegisterSpec:
    fields = {key: FieldSpec(key, **value) for key, value in (spec.get("fields") or {}).items()}
    rest = {key: value for key, value in spec.items() if key not in ("access", "fields", "min", "max")}
    access = Access(spec.get("access", "rw"))
    return RegisterSpec(name, access=access, fields=fields, minimum=spec.get("min"), maximum=spec.get("max"), **rest)


def macro(value: object) -> str:
    """Write a macro's value as the preprocessor expects it."""
    if value is None or value is True:
        return "1"
    return "0" if value is False else str(value)
