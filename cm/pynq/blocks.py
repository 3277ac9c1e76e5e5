# SPDX-License-Identifier: Apache-2.0
"""What a `.hwh` says of a design, in PYNQ's dictionaries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from cm.formats import hwh as handoff
from cm.formats.hwh import Hwh
from cm.formats.importers import channel_names
from cm.formats.registers import RegisterInfo

Description = Mapping[str, Any]


def blocks(hwh: Hwh) -> dict[str, dict[str, Any]]:
    """`ip_dict`: what the processor reaches, by path. Beside PYNQ's keys, `channels`: the streams of a DMA."""
    found: dict[str, dict[str, Any]] = {}
    for window in (*handoff.windows(hwh), *handoff.memories(hwh)):
        module = hwh.modules.get(window.instance)
        if module is None or (path := module.path.strip("/")) in found:
            continue
        pins = [line for line in handoff.interrupts(hwh) if line.instance == window.instance]
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
                for pin in pins
            },
            "channels": {
                channel.direction: stream
                for channel, stream in channel_names(hwh).items()
                if channel.instance == window.instance
            },
        }
    return found


def _register(info: RegisterInfo) -> dict[str, Any]:
    access = info.access or "read-write"
    return {
        "address_offset": info.offset,
        "size": info.size,
        "access": access,
        "description": info.doc,
        "fields": {
            field.name: {
                "bit_offset": field.lsb,
                "bit_width": field.width,
                "access": field.access or access,
                "description": field.doc,
            }
            for field in info.fields
        },
    }


def hierarchies(found: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """`hierarchy_dict`: by path, each with the blocks and the hierarchies right in it by name."""
    paths = {str(above): above for path in found for above in PurePosixPath(path).parents if above.name}
    made: dict[str, dict[str, Any]] = {
        path: {
            "fullpath": path,
            "ip": {PurePosixPath(name).name: one for name, one in found.items() if PurePosixPath(name).parent == above},
            "hierarchies": {},
        }
        for path, above in paths.items()
    }
    for path, above in paths.items():
        if above.parent.name:
            made[str(above.parent)]["hierarchies"][above.name] = made[path]
    return made
