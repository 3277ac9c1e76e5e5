# SPDX-License-Identifier: Apache-2.0
"""What a `.hwh` says of a design, in PYNQ's dictionaries."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from typing import Any

from cm.formats import hwh as handoff
from cm.formats.hwh import Hwh
from cm.formats.importers import channel_names
from cm.formats.registers import RegisterInfo

Description = Mapping[str, Any]


def blocks(hwh: Hwh) -> dict[str, dict[str, Any]]:
    """`ip_dict`: what the processor reaches, by path. Beside PYNQ's keys, `channels`: the streams of a DMA."""
    found: dict[str, dict[str, Any]] = {}
    channels, lines = channel_names(hwh), handoff.interrupts(hwh)
    for window in (*handoff.windows(hwh), *handoff.memories(hwh)):
        module = hwh.modules.get(window.instance)
        if module is None or (path := module.path.strip("/")) in found:
            continue
        found[path] = {
            "type": module.vlnv,
            "phys_addr": window.base,
            "addr_range": window.size,
            "fullpath": path,
            "mem_id": window.interface,
            "parameters": dict(module.parameters),
            "registers": {info.name: _register(info) for info in handoff.registers(module, window.interface)},
            "interrupts": {
                pin.port: {"controller": pin.controller or "", "index": pin.index, "fullpath": f"{path}/{pin.port}"}
                for pin in lines
                if pin.instance == window.instance
            },
            "channels": {one.direction: name for one, name in channels.items() if one.instance == window.instance},
        }
    return found


def _register(info: RegisterInfo) -> dict[str, Any]:
    access = info.access or "read-write"
    fields = {
        one.name: {
            "bit_offset": one.lsb,
            "bit_width": one.width,
            "access": one.access or access,
            "description": one.doc,
        }
        for one in info.fields
    }
    known = {"address_offset": info.offset, "size": info.size, "access": access, "description": info.doc}
    return {**known, "fields": fields}


def hierarchies(found: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """`hierarchy_dict`: by path, each with the blocks and the hierarchies right in it by name; the design is ``""``."""
    made: dict[str, dict[str, Any]] = {"": {"ip": {}, "hierarchies": {}}}
    for path, block in found.items():
        there, (*above, name) = made[""], path.split("/")
        for full, last in zip(accumulate(above, "{}/{}".format), above, strict=True):
            new = {"fullpath": full, "ip": {}, "hierarchies": {}}
            there["hierarchies"][last] = there = made.setdefault(full, new)
        there["ip"][name] = block
    return made
