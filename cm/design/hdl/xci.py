# SPDX-License-Identifier: Apache-2.0
"""Reads Vivado's IP instances (.xci) since 2020.2: JSON with the instance's name and ports as customised."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cm.design.hdl.detect import Detector
from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import Language, ModuleInfo, Port, PortDirection
from cm.design.hdl.protocols import UserProtocol

_SCHEMA = "xilinx.com:schema:json_instance"
_DIRECTIONS = {"in": PortDirection.IN, "out": PortDirection.OUT, "inout": PortDirection.INOUT}


def load_xci(path: Path, protocols: Sequence[UserProtocol] = ()) -> ModuleInfo:
    """Read the instance as a module with the ports of its customisation. Raises `HdlError`.

    Older files are XML without ports; use their component.xml, or a module with the same ports, instead.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8", errors="replace"))
        instance = data["ip_inst"]
        if not str(data.get("schema", "")).startswith(_SCHEMA):
            raise ValueError
        name, ports = str(instance["xci_name"]), instance["boundary"]["ports"]
    except OSError as error:
        raise HdlError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError):
        text = "has no list of ports (it is of a Vivado before 2020.2, or its output products were never generated)"
        raise HdlError(f"{path}: {text}: give component: or sim_sources:") from None
    found = tuple(_port(str(port), entries, str(path)) for port, entries in ports.items())
    return Detector(protocols).detect(ModuleInfo(name, str(path), Language.IPXACT, ports=found))


def _port(name: str, entries: Any, file: str) -> Port:
    entry = entries[0] if isinstance(entries, list) and entries else {}
    left, right = (str(entry.get(key, "0")) for key in ("size_left", "size_right"))
    width = abs(int(left) - int(right)) + 1 if left.isdigit() and right.isdigit() else None
    text = f"[{left}:{right}]" if "size_left" in entry else ""
    direction = _DIRECTIONS.get(str(entry.get("direction", "")), PortDirection.UNKNOWN)
    return Port(name, direction, width, file, range=text)
