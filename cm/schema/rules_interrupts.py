# SPDX-License-Identifier: Apache-2.0
"""What must be true of interrupts: they have a line, and those that share one can be distinguished."""

from __future__ import annotations

from collections.abc import Iterable

from cm.schema.construct import Context
from cm.schema.model import Config, Interrupt, Register
from cm.schema.problems import KeyPath, did_you_mean


def check_interrupts(config: Config, context: Context) -> None:
    """Report every interrupt of `config` that breaks a rule."""
    lines: dict[tuple[int | None, str | None], Interrupt] = {}
    for name, interrupt in config.interrupts.items():
        path: KeyPath = ("config", "interrupts", name)
        _check_line(interrupt, path, context)
        _check_status(interrupt, config, path, context)
        other = lines.setdefault((interrupt.base_address, interrupt.uio), interrupt)
        if other is not interrupt and not _apart(other, interrupt):
            message = f"interrupts {other.name} and {name} share a line and cannot be told apart"
            context.report(path, "interrupt_conflict", message, "give each its own bit of a status register")


def _apart(one: Interrupt, other: Interrupt) -> bool:
    told = None not in (one.status, one.bit, other.status, other.bit)
    return told and (one.status, one.bit) != (other.status, other.bit)


def _check_line(interrupt: Interrupt, path: KeyPath, context: Context) -> None:
    if interrupt.base_address is None and interrupt.uio is None:
        context.report(path, "missing_key", "which line?", "base_address of a register window, or uio")
    if interrupt.base_address is not None and interrupt.uio is not None:
        context.report((*path, "uio"), "name_clash", "base_address and uio both name the line", "keep one of them")


def _check_status(interrupt: Interrupt, config: Config, path: KeyPath, context: Context) -> None:
    if interrupt.status is None:
        for key, given in (("bit", interrupt.bit is not None), ("acknowledge", interrupt.acknowledge)):
            if given:
                context.report((*path, key), "missing_key", f"{key} of which register?", "status names it")
        return
    registers = {register.name: register for register in _registers(config)}
    if interrupt.status not in registers:
        hint = did_you_mean(interrupt.status, registers)
        message = f"there is no register {interrupt.status}"
        context.report((*path, "status"), "unknown_register", message, hint)
    elif interrupt.bit is None and interrupt.acknowledge:
        context.report((*path, "acknowledge"), "missing_key", "which bit is written?", "bit says which")
    elif interrupt.bit is not None and interrupt.bit >= registers[interrupt.status].width:
        width = registers[interrupt.status].width
        context.report((*path, "bit"), "value_range", f"bit {interrupt.bit} of {width} bits", f"0 to {width - 1}")


def _registers(config: Config) -> Iterable[Register]:
    yield from config.registers.values()
    for module in config.modules.values():
        yield from module.registers.values()
    for mode in config.modes.values():
        yield from mode.registers.values()
