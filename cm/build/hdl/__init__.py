# SPDX-License-Identifier: Apache-2.0
"""HDL in, interfaces out: ports, buses, clocks, resets and interrupts of Verilog, SystemVerilog and VHDL modules.

    extract(files, top=None, include_dirs=(), defines={}, parameters={}, protocols=()) -> list[ModuleInfo]
    load_component_xml(path) -> ModuleInfo         IP-XACT (spirit 1685-2009) as Vivado writes it
    compare(extracted, ipxact) -> list[Difference]
    load_protocols(path) -> tuple[UserProtocol, ...]

The types are in `cm.build.hdl.model` and need no parser; the parsers come with the extra `fpga-cm[build]`.
"""
