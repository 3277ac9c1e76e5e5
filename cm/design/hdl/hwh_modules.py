# SPDX-License-Identifier: Apache-2.0
"""The IPs of a design's .hwh as modules: Vivado lists their ports, and which belong to which bus."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

from cm.design.hdl.detect import detect
from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import FoundBy, Language, Mode, ModuleInfo, Port, PortDirection
from cm.formats.hwh.reader import BusInterface, InstancePort, ModuleInstance, read
from cm.frozen import replace

_DIRECTIONS = {"I": PortDirection.IN, "O": PortDirection.OUT, "IO": PortDirection.INOUT}
_SIGNALS = {"clk": ("clock", "CLK"), "rst": ("reset", "RST"), "interrupt": ("interrupt", "INTERRUPT")}
_MODES = {"MASTER": Mode.MASTER, "INITIATOR": Mode.MASTER, "SLAVE": Mode.SLAVE, "TARGET": Mode.SLAVE}


def load_hwh(path: Path, top: str | None = None) -> list[ModuleInfo]:
    """The IPs with ports, by the names of their instances; with a top, that one. HdlError where there is none."""
    try:
        design = read(path)
    except OSError as error:
        raise HdlError(f"{path}: cannot be read: {error.strerror}") from error
    found = [one for one in design.modules.values() if one.ports and top in (None, one.instance)]
    if not found:
        which = f"no instance {top}" if top else "no instance with ports"
        raise HdlError(f"{path}: {which}; there are: {', '.join(design.modules) or 'none'}")
    return [_told(detect(_module(one, path))) for one in found]


def _told(info: ModuleInfo) -> ModuleInfo:
    """With Vivado's word for what the file says of its buses; clocks that names leave open are no task for a reader."""
    buses = (
        replace(bus, found_by=FoundBy.HWH) if bus.found_by is FoundBy.ATTRIBUTE else bus for bus in info.interfaces
    )
    return replace(info, interfaces=tuple(buses), problems=())


def _module(one: ModuleInstance, path: Path) -> ModuleInfo:
    said: dict[str, dict[str, str]] = {}
    for bus in one.interfaces:
        if mode := _MODES.get(bus.type):
            for signal, port in bus.ports.items():
                said[port] = _of_bus(bus, signal, mode)
    ports = tuple(_port(port, said.get(port.name, {}), path) for port in one.ports.values())
    return ModuleInfo(one.instance, str(path), Language.HWH, ports=ports)


def _of_bus(bus: BusInterface, signal: str, mode: Mode) -> dict[str, str]:
    texts = [f"XIL_INTERFACENAME {bus.name}", *(f"{key} {value}" for key, value in bus.parameters.items() if value)]
    info = f"{bus.vlnv} {bus.name} {signal}"
    return {
        "x_interface_info": info,
        "x_interface_mode": mode.value,
        "x_interface_parameter": ", ".join(texts),
    }


def _port(port: InstancePort, said: dict[str, str], path: Path) -> Port:
    if port.kind.lower() in _SIGNALS:
        kind, signal = _SIGNALS[port.kind.lower()]
        words = (("FREQ_HZ", port.rate), ("SENSITIVITY", port.sensitivity), ("POLARITY", port.polarity))
        texts = [f"XIL_INTERFACENAME {port.name}", *(f"{key} {value}" for key, value in words if value)]
        said = {
            "x_interface_info": f"xilinx.com:signal:{kind}:1.0 {port.name} {signal}",
            "x_interface_parameter": ", ".join(texts),
        }
    way = _DIRECTIONS.get(port.direction, PortDirection.UNKNOWN)
    return Port(port.name, way, port.width, str(path), attributes=MappingProxyType(said))
