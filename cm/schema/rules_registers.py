# SPDX-License-Identifier: Apache-2.0
"""What must be true of registers: alignment, ranges, fields, and that no two visible ones are in one place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cm.schema.context import Context
from cm.schema.model import Access, BitField, Config, Register
from cm.schema.problems import KeyPath, did_you_mean, key_path

_Placed = tuple[KeyPath, Register]  # where it stands in the file, and the register


def check_registers(config: Config, context: Context) -> None:
    """Report everything about the registers of `config` that cannot be."""
    for _, path, register in _all(config, context):
        _check_place(register, path, config, context)
        _check_values(register, path, context)
        _check_fields(register, path, context)
    reported: set[tuple[KeyPath, KeyPath]] = set()
    for groups in _visible_sets(config):
        _check_together(groups, reported, context)


def _all(config: Config, context: Context) -> Iterator[tuple[KeyPath, KeyPath, Register]]:
    """Every register with its owner's path and its own."""
    for owner, registers in _owners(config):
        for name, register in registers.items():
            yield owner, context.where[owner, name], register


def _owners(config: Config) -> Iterator[tuple[KeyPath, Mapping[str, Register]]]:
    yield ("config",), config.registers
    for name, module in config.modules.items():
        yield ("config", "modules", name), module.registers
    for name, mode in config.modes.items():
        yield ("config", "modes", name), mode.registers


def _visible_sets(config: Config) -> Iterator[list[tuple[KeyPath, Mapping[str, Register]]]]:
    """The configuration's own, and for each mode that has more the owners that are visible together in it."""
    owners = dict(_owners(config))
    top: KeyPath = ("config",)
    yield [(top, config.registers)]
    for name, mode in config.modes.items():
        modules = [("config", "modules", module) for module in dict.fromkeys(mode.modules) if module in config.modules]
        more = [(path, owners[path]) for path in (*modules, ("config", "modes", name)) if owners[path]]
        if more:
            yield [(top, config.registers), *more]


def _check_place(register: Register, path: KeyPath, config: Config, context: Context) -> None:
    if register.address % (register.width // 8):
        message = f"address {register.address:#x} of a register of {register.width} bits"
        hint = f"a multiple of {register.width // 8}"
        context.report((*path, "offset"), "misaligned_offset", message, hint)
    if register.region is not None and register.region not in config.regions:
        hint = did_you_mean(register.region, [*config.regions, "static"])
        context.report((*path, "region"), "unknown_region", f"there is no region {register.region}", hint)


def _check_values(register: Register, path: KeyPath, context: Context) -> None:
    low, high = register.minimum, register.maximum
    for key, value in (("default", register.default), ("reset", register.reset), ("min", low), ("max", high)):
        if value is not None and value >> register.width:
            message = f"{value:#x} does not fit a register of {register.width} bits"
            context.report((*path, key), "value_range", message, f"at most {(1 << register.width) - 1:#x}")
    if low is not None and high is not None and low > high:
        context.report((*path, "min"), "value_range", f"min {low} is above max {high}", "min is the smaller one")
    if register.default is None:
        return
    if register.access in (Access.RO, Access.W1C):
        kind = "read-only" if register.access is Access.RO else "write-one-to-clear"
        message = f"a {kind} register has no value to be written when a mode is entered"
        context.report((*path, "default"), "not_applicable", message, "reset says what it reads after loading")
    elif (low is not None and register.default < low) or (high is not None and register.default > high):
        hint = f"from {0 if low is None else low} to {(1 << register.width) - 1 if high is None else high}"
        context.report((*path, "default"), "value_range", f"{register.default} is out of range", hint)


def _check_fields(register: Register, path: KeyPath, context: Context) -> None:
    used: list[BitField] = []
    for name, field in register.fields.items():
        here = (*path, "fields", name)
        if field.lsb + field.width > register.width:
            message = f"bits {field.lsb + field.width - 1}:{field.lsb} of a register of {register.width} bits"
            context.report(here, "value_range", message, f"bits {register.width - 1}:0")
        for other in used:
            if other.mask & field.mask:
                hint = f"{other.name} has bits {other.lsb + other.width - 1}:{other.lsb}"
                context.report(here, "field_overlap", f"field {name} overlaps field {other.name}", hint)
        used.append(field)
        for word, value in field.values.items():
            if value >> field.width:
                message = f"{value:#x} does not fit {field.width} bits"
                context.report((*here, "values", word), "value_range", message, f"at most {(1 << field.width) - 1:#x}")


def _check_together(
    groups: list[tuple[KeyPath, Mapping[str, Register]]], reported: set[tuple[KeyPath, KeyPath]], context: Context
) -> None:
    """Of registers that are visible in one mode: one place per name, one name per place.

    The same name at the same place, again, is no clash: a module or mode may give a register of the
    configuration another default.
    """
    by_name: dict[str, _Placed] = {}
    for owner, registers in groups:
        for name, register in registers.items():
            path = context.where[owner, name]
            if name not in by_name:
                by_name[name] = (path, register)
            elif not _same_place(by_name[name][1], register):
                _report_pair(path, by_name[name], "name_clash", f"register {name} is elsewhere too", reported, context)
    ordered = sorted(by_name.values(), key=lambda placed: placed[1].address)
    furthest = ordered[0] if ordered else None
    for placed in ordered[1:]:
        assert furthest is not None
        if placed[1].address < _end(furthest[1]):
            message = f"register {placed[1].name} overlaps register {furthest[1].name}"
            _report_pair(placed[0], furthest, "overlapping_registers", message, reported, context)
        if _end(placed[1]) > _end(furthest[1]):
            furthest = placed


def _same_place(one: Register, other: Register) -> bool:
    return (one.address, one.width, one.region) == (other.address, other.width, other.region)


def _end(register: Register) -> int:
    return register.address + register.width // 8


def _report_pair(
    path: KeyPath, other: _Placed, code: str, message: str, reported: set[tuple[KeyPath, KeyPath]], context: Context
) -> None:
    if (path, other[0]) in reported:  # the same pair is visible in several modes
        return
    reported.add((path, other[0]))
    there = key_path(other[0])
    context.report(path, code, message, f"{there} is at {other[1].address:#x}, {other[1].width} bits")
