# SPDX-License-Identifier: Apache-2.0
"""Reads registers from the files of other tools, by their suffixes, and makes registers of the schema of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cm.design.errors import BuildError
from cm.design.hdl.hls_registers import hls_items, is_hls
from cm.design.hdl.ipxact_registers import ipxact_items
from cm.design.hdl.systemrdl_registers import systemrdl_items
from cm.formats.registers import Item, RegisterBank, RegisterInfo
from cm.schema.model import Memory, Register


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
        ".json": _json,
    }
    reader = _hls if is_hls(path) else readers.get(path.suffix.lower())
    if reader is None:
        raise BuildError(f"{path}: registers are read from {', '.join(readers)} files, and *_s_axi.v or .vhd of HLS")
    notes: list[str] = []
    bank = RegisterBank(notes)
    bank.add("", 0, None, reader(path, module, bus, notes))
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


def _json(path: Path, module: str, bus: str, notes: list[str]) -> list[Item]:
    """LiteX' csr.json, or the config.json beside what HLS wrote: arguments by top and bundle."""
    del bus
    try:
        tops: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if "csr_registers" in tops:
            return list(_litex(tops, module, notes))
        bundles = tops[module] if len(tops) > 1 else next(iter(tops.values()))
        return list(_arguments(bundles))
    except (ValueError, KeyError, TypeError, AttributeError, StopIteration, RecursionError) as error:
        raise BuildError(f"{path}: not a config.json of HLS, which has top, bundle and argument: {error!r}") from None


def _litex(said: Mapping[str, Any], module: str, notes: list[str]) -> Iterator[Item]:
    """The registers of a bank `module`, or of all, at addresses from its base, or the lowest.

    Source: `get_csr_json` of LiteX. One that is wider than a bus word is several, of which `_0` has the lowest bits.
    """
    bases, constants = said["csr_bases"], said["constants"]
    base = bases[module] if module in bases else min(bases.values())
    step, width = constants.get("config_csr_alignment", 32) // 8, constants.get("config_csr_data_width", 32)
    prefix = f"{module}_" if module in bases else ""
    for name, one in said["csr_registers"].items():
        if not name.startswith(prefix):
            continue
        words, access = one["size"], "read-only" if one["type"] == "ro" else ""
        for number in range(words):
            part = name.removeprefix(prefix) + (f"_{words - 1 - number}" if words > 1 else "")
            yield RegisterInfo(part, one["addr"] - base + number * step, width, access, widest=width)
        if words > 1:
            notes.append(
                f"{name}: {words} words, the highest first, as LiteX' own accessors have it whatever its order"
            )


def _arguments(bundles: Mapping[str, Mapping[str, Mapping[str, str]]]) -> Iterator[Item]:
    for argument in (one for bundle in bundles.values() for one in bundle.values()):
        name, offset, size = argument["name"], int(argument["offset"], 0), int(argument["size"], 0)
        if size <= 8:  # what is longer is an array, which *_s_axi.v describes
            yield RegisterInfo(name, offset, 8 * size, widest=32 if size > 4 else 0)
