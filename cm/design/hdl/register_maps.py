# SPDX-License-Identifier: Apache-2.0
"""Reads registers from the files of other tools, by their suffixes, and makes registers of the schema of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from cm.design.errors import BuildError
from cm.design.hdl.hls_registers import hls_items, is_hls
from cm.design.hdl.ipxact_registers import ipxact_items
from cm.design.hdl.json_registers import json_items
from cm.design.hdl.systemrdl_registers import systemrdl_items
from cm.formats.registers import Item, RegisterBank, RegisterInfo
from cm.schema.model import Memory, Register

_WIDEST = 1 << 16  # bits


class RegisterMap(NamedTuple):
    """What a file describes, at addresses from 0, and a line for each thing that a schema cannot have."""

    registers: dict[str, Register]
    memories: dict[str, Memory]
    notes: list[str]


def read_register_map(path: Path, module: str, bus: str = "") -> RegisterMap:
    """Read the registers in `path` according to its suffix, and its arrays and memories.

    `module` selects one of several in a .hwh, .rdl or .json file; `bus` is the interface whose registers are wanted.
    """
    readers: Mapping[str, Callable[[Path, str, str, list[str]], list[Item]]] = {
        ".xml": lambda path, _, bus, notes: ipxact_items(path, bus, notes),
        ".hwh": _hwh,
        ".rdl": lambda path, module, _, notes: systemrdl_items(path, module, notes),
        ".h": _hls,
        ".json": lambda path, module, _, notes: json_items(path, module, notes),
    }
    reader = _hls if is_hls(path) else readers.get(path.suffix.lower())
    if reader is None:
        raise BuildError(f"{path}: registers are read from {', '.join(readers)} files, and *_s_axi.v or .vhd of HLS")
    notes: list[str] = []
    bank = RegisterBank(notes)
    try:
        items = reader(path, module, bus, notes)
        wide = next((item.name for item in items if isinstance(item, RegisterInfo) and item.size > _WIDEST), None)
        if wide is not None:
            raise BuildError(f"{path}: {wide} has more than {_WIDEST} bits, which no register has")
        bank.add("", 0, None, items)
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise BuildError(f"{path}: a value in it is none that a register can have: {error}") from None
    if not (bank.registers or bank.memories):
        raise BuildError(f"{path} describes no registers")
    return RegisterMap(bank.registers, bank.memories, notes)


def _hls(path: Path, module: str, bus: str, notes: list[str]) -> list[Item]:
    del module, bus, notes  # one file for each bus of a module
    return hls_items(path)


def _hwh(path: Path, module: str, bus: str, notes: list[str]) -> list[Item]:
    from cm.formats.hwh import read  # a reader that only this needs

    del notes
    design = read(path)
    having = {name: instance for name, instance in design.modules.items() if any(instance.registers.values())}
    chosen = [instance for name, instance in having.items() if module in (name, instance.name, instance.type)]
    if len(chosen) != 1:
        raise BuildError(f"{path}: {module} is not one of the instances with registers: {', '.join(having) or 'none'}")
    blocks = {name.lower(): block for name, block in chosen[0].registers.items()}
    return list(blocks.get(bus.lower()) or [register for block in blocks.values() for register in block])
