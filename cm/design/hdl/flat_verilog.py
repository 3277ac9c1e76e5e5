# SPDX-License-Identifier: Apache-2.0
"""A flat wrapper around a SystemVerilog module with interface ports; slang knows what the interfaces contain."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.hdl.clock_reset_names import is_clock, is_reset, reset_polarity
from cm.design.hdl.errors import HdlError
from cm.design.hdl.extract import Sources
from cm.design.hdl.flat_wrappers import IN, OUT, Flat, FlatPort, unique_ports, wrapper_name
from cm.design.hdl.model import Port, PortDirection
from cm.design.hdl.verilog import VerilogReader, expression

_PROBE = "cm_flat_probe"
_WORD = re.compile(r"\w+")


def flat_verilog(top: str, wanted: Sources) -> Flat:
    """Return the wrapper of module `top`. Raises `HdlError` with the reason if none is possible."""
    reader = VerilogReader(wanted.include_dirs, wanted.defines)
    for path in wanted.paths:
        reader.parse(path, path.read_text(encoding="utf-8", errors="replace"))
    body = reader.elaborate(top, {name: expression(value) for name, value in wanted.parameters.items()})
    interfaces = {port.name: _interface(top, port) for port in body.portList if port.kind.name == "InterfacePort"}
    for name in wanted.interface_parameters:
        if name not in interfaces:
            raise HdlError(f"{top} has no interface port {name}; there are: {', '.join(interfaces) or 'none'}")
    singles = [_instance(name, kind, wanted) for name, (kind, _, _) in interfaces.items()]
    reader.parse(Path(f"{_PROBE}.sv"), "\n".join([f"module {_PROBE};", *singles, "endmodule\n"]))
    probe = {member.name: member for member in reader.elaborate(_PROBE, {}) if member.kind.name == "Instance"}
    ports: list[FlatPort] = []
    for port in body.portList:
        if port.name in interfaces:
            _, modport, count = interfaces[port.name]
            for index in range(count) if count is not None else (None,):
                ports += _signals(top, port.name, probe[port.name].body, modport, index)
        else:
            ports.append(_plain(top, port))
    own = {name: _ties(top, name, probe[name].body, ports) for name in interfaces}
    added = {tie: FlatPort(tie, IN, 1) for ties in own.values() for tie in ties.values() if _WORD.fullmatch(tie)}
    added = {name: port for name, port in added.items() if name not in {port.name for port in ports}}
    unique_ports(top, [*added.values(), *ports])
    instances = {name: _instance(name, kind, wanted, count, own[name]) for name, (kind, _, count) in interfaces.items()}
    return Flat(wrapper_name(top), ".sv", _text(top, wanted, ports, list(added.values()), instances))


def _interface(top: str, port: Any) -> tuple[str, str, int | None]:
    """Return interface, modport, and the length of an array of them."""
    if port.interfaceDef is None:
        raise HdlError(f"{top}: port {port.name} is any interface, or one that no file given declares")
    if not port.modport:
        kind = port.interfaceDef.name
        raise HdlError(f"{top}: port {port.name} is {kind} without a modport: its signals have no direction")
    ranges = port.declaredRange or []
    if len(ranges) > 1:
        raise HdlError(f"{top}: port {port.name} is an array of arrays of interfaces: wrap it by hand")
    return port.interfaceDef.name, port.modport, ranges[0].width if ranges else None


def _ties(top: str, name: str, body: Any, ports: list[FlatPort]) -> dict[str, str]:
    """What the interface's own ports are tied to: the module's clock and reset, or ports of the wrapper for them."""
    found = {}
    plain = [Port(port.name, port.direction, port.width) for port in ports if not port.inner]
    for own in body.portList:
        port = Port(own.name, PortDirection(own.direction.name.lower()), own.type.bitWidth)
        kind = next((kind for kind in (is_clock, is_reset) if kind(port)), None)
        if kind is None:
            message = f"the interface of {name} has a port {port.name} that is no clock or reset"
            raise HdlError(f"{top}: {message}: wrap it by hand")
        same = [one.name for one in plain if kind(one)]
        known = [one for one in same if one.lower() == port.name.lower()] or same
        if len(known) > 1:
            message = f"the interface of {name} has a port {port.name}, which may be any of {', '.join(known)}"
            raise HdlError(f"{top}: {message}: give them one name, or wrap it by hand")
        inverted = bool(known) and kind is is_reset and reset_polarity(known[0]) is not reset_polarity(port.name)
        found[port.name] = ("~" if inverted else "") + (known[0] if known else port.name)
    return found


def _instance(
    name: str, kind: str, wanted: Sources, count: int | None = None, ties: Mapping[str, str] = MappingProxyType({})
) -> str:
    given = wanted.interface_parameters.get(name, {})
    values = ", ".join(f".{key}({expression(value)})" for key, value in given.items())
    pins = ", ".join(f".{own}({tie})" for own, tie in ties.items())
    return f"    {kind} {f'#({values}) ' if values else ''}{name} {'' if count is None else f'[{count}] '}({pins});"


def _signals(top: str, name: str, body: Any, modport: str, index: int | None) -> Iterator[FlatPort]:
    flat, inner = (name, name) if index is None else (f"{name}_{index}", f"{name}[{index}]")
    own = {port.name for port in body.portList}  # tied where the interface is instantiated
    found = next((member for member in body if member.kind.name == "Modport" and member.name == modport), None)
    for signal in found or ():
        if signal.kind.name != "ModportPort" or signal.name in own:
            continue  # a task or function
        direction = PortDirection(signal.direction.name.lower())
        if direction not in (IN, OUT):
            raise HdlError(f"{top}: {name}.{signal.name} is bidirectional: write a wrapper by hand")
        if not signal.type.isIntegral or not signal.type.bitWidth:
            raise HdlError(f"{top}: {name}.{signal.name} is not a vector of bits ({signal.type}): wrap it by hand")
        yield FlatPort(f"{flat}_{signal.name}", direction, signal.type.bitWidth, f"{inner}.{signal.name}")


def _plain(top: str, port: Any) -> FlatPort:
    if port.kind.name != "Port" or not port.type.isIntegral:
        raise HdlError(f"{top}: port {port.name} is neither an interface nor a vector of bits: wrap it by hand")
    return FlatPort(port.name, PortDirection(port.direction.name.lower()), port.type.bitWidth)


def _text(top: str, wanted: Sources, ports: list[FlatPort], added: list[FlatPort], instances: Mapping[str, str]) -> str:
    declared = [f"    {_KINDS[port.direction]} {_range(port.width)}{port.name}" for port in (*added, *ports)]
    assigned = [
        f"    assign {port.inner} = {port.name};" if port.direction is IN else f"    assign {port.name} = {port.inner};"
        for port in ports
        if port.inner
    ]
    values = [f".{name}({expression(value)})" for name, value in wanted.parameters.items()]
    given = f"#({', '.join(values)}) " if values else ""
    pins = [f"        .{name}({name})" for name in (*(p.name for p in ports if not p.inner), *instances)]
    lines = [
        "// SPDX-License-" + "Identifier: Apache-2.0",
        f"// Generated by cm build: {top} with flat ports in place of its interfaces.",
        "`default_nettype none",
        "/* verilator lint_off TIMESCALEMOD */",
        "",
        f"module {wrapper_name(top)} (",
        ",\n".join(declared),
        ");",
        *instances.values(),
        "",
        *assigned,
        "",
        f"    {top} {given}inner (",
        ",\n".join(pins),
        "    );",
        "endmodule",
        "",
        "`default_nettype wire",
    ]
    return "\n".join(lines) + "\n"


_KINDS = {IN: "input  wire", OUT: "output wire", PortDirection.INOUT: "inout  wire"}


def _range(width: int) -> str:
    return f"[{width - 1}:0] " if width > 1 else ""
