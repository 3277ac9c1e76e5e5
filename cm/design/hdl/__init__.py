# SPDX-License-Identifier: Apache-2.0
"""HDL → modules with their interfaces, clocks, resets and interrupts.

    extract.read(Sources(files, …)) -> Reading      Verilog, SystemVerilog, VHDL
    ipxact.load_component_xml(path) -> ModuleInfo   IP-XACT (spirit 1685-2009) as Vivado writes it
    compare.compare(extracted, ipxact) -> list[Difference]
    protocols.load_protocols(path) -> tuple[UserProtocol, ...]

The types are in `cm.design.hdl.model` and need no parser; the parsers come with the extra `fpga-cm[build]`.
"""
