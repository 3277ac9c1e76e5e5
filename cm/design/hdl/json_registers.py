# SPDX-License-Identifier: Apache-2.0
"""Register maps in JSON: LiteX' csr.json, axion-hdl, bust, and the config.json beside what HLS wrote."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.errors import BuildError
from cm.design.hdl.systemrdl_registers import READS, WRITES
from cm.formats.registers import Item, RegisterField, RegisterInfo

_ACCESS = {"ro": "read-only", "r": "read-only", "na": "read-only", "wo": "write-only", "w": "write-only"}


def json_items(path: Path, module: str, notes: list[str]) -> list[Item]:
    """The registers of a file; `module` selects one of several. Raises BuildError for what is none of these."""
    try:
        said: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if "csr_registers" in said:
            return list(_litex(said, module, notes))
        if "registers" in said and "module" in said:
            return [_axion(one) for one in said["registers"]]
        if "bus" in said and "register" in said.get("module", ()):
            return list(_bust(said["bus"], said["module"]))
        return list(_arguments(said[module] if len(said) > 1 else next(iter(said.values()))))
    except (ValueError, KeyError, TypeError, AttributeError, StopIteration, RecursionError) as error:
        what = "not a config.json of HLS, which has top, bundle and argument, nor of LiteX, axion-hdl or bust"
        raise BuildError(f"{path}: {what}: {error!r}") from None


def _number(value: Any) -> int:
    return int(value, 0) if isinstance(value, str) else int(value)


def _axion(one: Mapping[str, Any]) -> RegisterInfo:
    """A register of axion-hdl; its values' names are by number."""
    fields = tuple(
        RegisterField(
            name=part["name"],
            lsb=part["bit_offset"],
            width=part["width"],
            access=_ACCESS.get(part["access"].lower(), ""),
            reset=None if part["access"].lower() == "ro" else _number(part.get("default", 0)),
            values=MappingProxyType({name: int(value) for value, name in part.get("enum_values", {}).items()}),
        )
        for part in one.get("fields", ())
    )
    access = _ACCESS.get(one["access"].lower(), "")
    reset = None if fields or access == "read-only" else _number(one.get("default", 0))
    width = _number(one["width"])
    doc = one.get("description", "")
    return RegisterInfo(one["name"], _number(one["addr"]), width, access, reset, fields, doc, widest=min(width, 32))


def _bust(bus: Mapping[str, Any], module: Mapping[str, Any]) -> Iterator[RegisterInfo]:
    """The registers of a module of bust; what has no address gets the lowest free one."""
    width = _number(bus["data_width"])
    step = width // 8 if module.get("byte_addressable", bus["type"] != "ipbus") else 1
    taken = {_number(one["address"]) for one in module["register"] if "address" in one}
    free = (at for at in range(0, 1 << 32, step) if at not in taken)
    for one in module["register"]:
        at = _number(one["address"]) if "address" in one else next(free)
        fields, used = [], 0
        for part in one.get("fields", ()):
            lsb = _number(part.get("position", used))
            used = lsb + _number(part.get("width", 1))
            fields.append(_bust_field(part, lsb))
        if not fields:
            size = 1 if one.get("type") == "bit" else _number(one.get("width", width))
            fields.append(_bust_field(one | {"width": size}, 0))
        doc = one.get("description", "")
        yield RegisterInfo(one["name"], at * width // 8 // step, width, fields=tuple(fields), doc=doc)


def _bust_field(one: Mapping[str, Any], lsb: int) -> RegisterField:
    driven = one.get("hw", "r") in ("w", "rw") or one.get("type") in ("hash", "version")
    return RegisterField(
        name=one["name"],
        lsb=lsb,
        width=_number(one.get("width", 1)),
        access="read-only" if one.get("type") in ("hash", "version") else _ACCESS.get(one.get("sw", "rw"), ""),
        write="oneToSet" if one.get("singlepulse") else WRITES.get(one.get("onwrite") or "", ""),
        read=READS.get(one.get("onread") or "", ""),
        reset=None if driven else _number(one.get("reset", 0)),
        values=MappingProxyType({item["name"]: _number(item["value"]) for item in one.get("enums", ())}),
        volatile=driven,
        doc=one.get("description", ""),
    )


def _litex(said: Mapping[str, Any], module: str, notes: list[str]) -> Iterator[Item]:
    """The registers of a bank `module`, at addresses from its base, or of all, from that of the window of all banks.

    Source: `get_csr_json` of LiteX, and its EventManager, whose `pending` is cleared by ones though it is "rw". One
    that is wider than a bus word is several, of which `_0` has the lowest bits.
    """
    bases, constants = said["csr_bases"], said["constants"]
    whole = said.get("memories", {}).get("csr", {}).get("base", min(bases.values()))
    base = bases.get(module, whole)
    step, width = constants.get("config_csr_alignment", 32) // 8, constants.get("config_csr_data_width", 32)
    prefix = f"{module}_" if module in bases else ""
    for name, one in said["csr_registers"].items():
        if not name.startswith(prefix):
            continue
        words, access = one["size"], "read-only" if one["type"] == "ro" else ""
        manager, _, last = name.rpartition("_")
        clears = last == "pending" and {f"{manager}_status", f"{manager}_enable"} <= said["csr_registers"].keys()
        for number in range(words):
            part = name.removeprefix(prefix) + (f"_{words - 1 - number}" if words > 1 else "")
            does = (RegisterField("pending", 0, width, write="oneToClear"),) if clears else ()
            yield RegisterInfo(part, one["addr"] - base + number * step, width, access, fields=does, widest=width)
        if words > 1:
            notes.append(
                f"{name}: {words} words, the highest first, as LiteX' own accessors have it whatever its order"
            )


def _arguments(bundles: Mapping[str, Mapping[str, Mapping[str, str]]]) -> Iterator[Item]:
    for argument in (one for bundle in bundles.values() for one in bundle.values()):
        name, offset, size = argument["name"], int(argument["offset"], 0), int(argument["size"], 0)
        if size <= 8:  # what is longer is an array, which *_s_axi.v describes
            yield RegisterInfo(name, offset, 8 * size, widest=32 if size > 4 else 0)
