# SPDX-License-Identifier: Apache-2.0
"""What must be true of registers: alignment, ranges, fields, and that no two visible ones overlap."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping

from cm.schema.construct import Context
from cm.schema.model import Access, BitField, Config, Mode, Register
from cm.schema.problems import KeyPath, did_you_mean, key_path

_Placed = tuple[KeyPath, Register]  # where it stands in the file, and the register
_LONGEST = 8  # bytes of a register


def check_registers(config: Config, context: Context) -> None:
    """Report every register of `config` that breaks a rule."""
    for _, path, register in _all(config, context):
        _check_place(register, path, config, context)
        check_values(register, path, context)
        check_fields(register, path, context)
    own = [(context.where[("config",), name], register) for name, register in config.registers.items()]
    together = _Together(own, context)
    for mode in config.modes.values():
        together.check([(context.where[owner, name], r) for owner, name, r in _added(mode, config)])


def check_runs(config: Config, context: Context) -> None:
    """Report modes that start what cannot be started."""
    for name, mode in config.modes.items():
        if mode.run is None:
            continue
        here: KeyPath = ("config", "modes", name, "run")
        started = list(config.controls(name)) if all(m in config.modules for m in mode.modules) else None
        if started == []:
            wanted = "start" if mode.run == "once" else "start and auto_restart"
            message = "no module of this mode has a register that starts it"
            context.report(here, "not_applicable", message, f"a register with fields {wanted}, such as HLS' ap_ctrl")
        for register, _ in started or ():
            if register.default is not None:
                context.report(here, "not_applicable", f"{register.name} has a default too", "one of the two")


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


def _added(mode: Mode, config: Config) -> Iterator[tuple[KeyPath, str, Register]]:
    """The registers that are visible in `mode` beside the configuration's: of its modules, and its own."""
    for module in dict.fromkeys(mode.modules):
        if module in config.modules:
            for name, register in config.modules[module].registers.items():
                yield ("config", "modules", module), name, register
    for name, register in mode.registers.items():
        yield ("config", "modes", mode.name), name, register


def _check_place(register: Register, path: KeyPath, config: Config, context: Context) -> None:
    if register.address % (register.width // 8):
        message = f"address {register.address:#x} of a register of {register.width} bits"
        hint = f"a multiple of {register.width // 8}"
        context.report((*path, "offset"), "misaligned_offset", message, hint)
    if register.region is not None and register.region not in config.regions:
        hint = did_you_mean(register.region, [*config.regions, "static"])
        context.report((*path, "region"), "unknown_region", f"there is no region {register.region}", hint)


def check_values(register: Register, path: KeyPath, context: Context) -> None:
    """Report values that a register cannot have; of a build schema's too, as `check_fields`."""
    low, high = register.minimum, register.maximum
    for key, value in (("default", register.default), ("reset", register.reset), ("min", low), ("max", high)):
        if value is not None and value >> register.width:
            message = f"{value:#x} does not fit a register of {register.width} bits"
            context.report((*path, key), "value_range", message, f"at most {(1 << register.width) - 1:#x}")
    bits = {"float32": 32, "float64": 64}.get(register.type, register.width)
    if bits != register.width:
        message = f"a {register.type} in a register of {register.width} bits"
        context.report((*path, "type"), "value_range", message, f"width: {bits}")
    if register.fraction > register.width or (register.fraction and register.type.startswith("float")):
        message = f"{register.fraction} bits behind the point of a {register.type} of {register.width} bits"
        context.report((*path, "fraction"), "value_range", message, "uint or int, and no more than its bits")
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


def check_fields(register: Register, path: KeyPath, context: Context) -> None:
    """Report fields that do not fit their register or each other, and names of values that do not fit their field."""
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
        whole = register.access in (Access.RO, Access.WO) and field.access is not None
        if whole and register.access_of(field).kind.writable is (register.access is Access.RO):
            message = f"a field of other access in a register of {register.access.value}"
            context.report((*here, "access"), "not_applicable", message, "access of the register: rw")
        for word, value in field.values.items():
            if value >> field.width:
                message = f"{value:#x} does not fit {field.width} bits"
                context.report((*here, "values", word), "value_range", message, f"at most {(1 << field.width) - 1:#x}")


class _Together:
    """Checks registers that are visible in one mode: one place per name, one name per place.

    The same name at the same place, again, is not a clash: a module or mode may give a register of the
    configuration another default. The configuration's registers are compared with each other once,
    and those that a mode adds with them and with each other.
    """

    def __init__(self, own: list[_Placed], context: Context) -> None:
        self._context = context
        self._reported: set[tuple[KeyPath, KeyPath]] = set()
        self._names = {register.name: (path, register) for path, register in own}
        self._sorted = sorted(own, key=_address)
        self._neighbours(self._sorted)

    def check(self, added: list[_Placed]) -> None:
        """Compare what a mode adds."""
        names: dict[str, _Placed] = {}
        for path, register in added:
            other = names.get(register.name) or self._names.get(register.name)
            if other is None or _same_place(other[1], register):
                names[register.name] = (path, register)
            else:
                self._report(path, other, "name_clash", f"register {register.name} is elsewhere too")
        self._neighbours(sorted(names.values(), key=_address))
        for placed in names.values():
            for other in self._overlapping(placed[1]):
                if other[1].name != placed[1].name:
                    self._overlap(placed, other)

    def _neighbours(self, ordered: list[_Placed]) -> None:
        """Report overlaps in a list in the order of addresses."""
        furthest = ordered[0] if ordered else None
        for placed in ordered[1:]:
            assert furthest is not None
            if placed[1].address < _end(furthest[1]):
                self._overlap(placed, furthest)
            if _end(placed[1]) > _end(furthest[1]):
                furthest = placed

    def _overlapping(self, register: Register) -> Iterator[_Placed]:
        """The configuration's registers that overlap `register`; none is longer than 8 bytes."""
        index = bisect_left(self._sorted, register.address - _LONGEST + 1, key=_address)
        while index < len(self._sorted) and self._sorted[index][1].address < _end(register):
            if _end(self._sorted[index][1]) > register.address:
                yield self._sorted[index]
            index += 1

    def _overlap(self, placed: _Placed, other: _Placed) -> None:
        message = f"register {placed[1].name} overlaps register {other[1].name}"
        self._report(placed[0], other, "overlapping_registers", message)

    def _report(self, path: KeyPath, other: _Placed, code: str, message: str) -> None:
        if (path, other[0]) in self._reported:  # the same pair is visible in several modes
            return
        self._reported.add((path, other[0]))
        hint = f"{key_path(other[0])} is at {other[1].address:#x}, {other[1].width} bits"
        self._context.report(path, code, message, hint)


def _address(placed: _Placed) -> int:
    return placed[1].address


def _same_place(one: Register, other: Register) -> bool:
    return (one.address, one.width, one.region) == (other.address, other.width, other.region)


def _end(register: Register) -> int:
    return register.address + register.width // 8
