# SPDX-License-Identifier: Apache-2.0
"""Reads Verilog, SystemVerilog and VHDL modules, and finds their ports, buses, clocks, resets and interrupts.

    extract(files, top=None, include_dirs=(), defines={}, parameters={}, protocols=()) -> list[ModuleInfo]
    load_component_xml(path) -> ModuleInfo         IP-XACT (spirit 1685-2009) as Vivado writes it
    compare(extracted, ipxact) -> list[Difference]
    load_protocols(path) -> tuple[UserProtocol, ...]

The types are in `cm.design.hdl.model` and need no parser; the parsers come with the extra `fpga-cm[build]`.
"""

from __future__ import annotations

from cm.design.hdl.compare import Difference, compare
from cm.design.hdl.errors import HdlError, ModuleNotFound, ParserMissing, UnknownParameter
from cm.design.hdl.extract import Reading, extract, read, roots
from cm.design.hdl.ipxact import load_component_xml, load_xci
from cm.design.hdl.model import (
    FoundBy,
    Interface,
    Interrupt,
    Language,
    Leftover,
    Mode,
    ModuleClock,
    ModuleInfo,
    Parameter,
    Polarity,
    Port,
    PortDirection,
    Problem,
    Reset,
)
from cm.design.hdl.protocols import Binding, UserProtocol, load_protocols, parse_protocols

__all__ = [
    "Binding",
    "Difference",
    "FoundBy",
    "HdlError",
    "Interface",
    "Interrupt",
    "Language",
    "Leftover",
    "Mode",
    "ModuleClock",
    "ModuleInfo",
    "ModuleNotFound",
    "Parameter",
    "ParserMissing",
    "Polarity",
    "Port",
    "PortDirection",
    "Problem",
    "Reading",
    "Reset",
    "UnknownParameter",
    "UserProtocol",
    "compare",
    "extract",
    "load_component_xml",
    "load_protocols",
    "load_xci",
    "parse_protocols",
    "read",
    "roots",
]
