# SPDX-License-Identifier: Apache-2.0
"""The top: block design beside static part. Both use the same port names, so most wiring is by name."""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.generate.verilog_module import Netlist, Signal, zeros
from cm.design.hdl.model import PortDirection
from cm.design.plan.system import System

IN, OUT, INOUT = PortDirection.IN, PortDirection.OUT, PortDirection.INOUT

# pins of the Zynq-7000 processing system, as its external interfaces DDR and FIXED_IO name them
_ZYNQ_PINS = (
    *(("DDR_" + name, width) for name, width in (("addr", 15), ("ba", 3), ("cas_n", 1), ("ck_n", 1), ("ck_p", 1))),
    *(("DDR_" + name, width) for name, width in (("cke", 1), ("cs_n", 1), ("dm", 4), ("dq", 32), ("dqs_n", 4))),
    *(("DDR_" + name, width) for name, width in (("dqs_p", 4), ("odt", 1), ("ras_n", 1), ("reset_n", 1), ("we_n", 1))),
    *(("FIXED_IO_" + name, width) for name, width in (("ddr_vrn", 1), ("ddr_vrp", 1), ("mio", 54), ("ps_clk", 1))),
    *(("FIXED_IO_" + name, width) for name, width in (("ps_porb", 1), ("ps_srstb", 1))),
)


def top(system: System, static: Netlist) -> Netlist:
    """The module ``cm_top`` around ``cm_system_wrapper`` and ``cm_static`` (cell ``static_part``)."""
    net = Netlist("cm_top", f"Top of {system.project.name}: block design and static part.")
    outer: dict[str, str | None] = {}
    inner: dict[str, str | None] = {}
    if system.platform.name == "zynq7000":
        for name, width in _ZYNQ_PINS:
            outer[name] = net.port(name, INOUT, width)
    for port in static.ports:
        if port.name.startswith("ext_") or _is_free_stream(system, port.name):
            assert port.direction is not None
            inner[port.name] = net.port(port.name, port.direction, port.width)
            continue
        wire = net.wire(port.name, port.width)
        inner[port.name] = wire
        outer[_outer_name(port)] = wire
    for name, value in _missing(system, inner):
        outer[name] = value
    net.instance("cm_system_wrapper", "system", outer, comment="Block design: tcl/block_design.tcl")
    net.instance("cm_static", "static_part", inner, comment="Regions and what stands round them")
    return net


def _outer_name(port: Signal) -> str:
    """The block design's port at the other end: a slave here is a master there."""
    for mine, theirs in (("s_axi_", "m_axi_"), ("m_axi_", "s_axi_")):
        if port.name.startswith(mine):
            return theirs + port.name.removeprefix(mine)
    return port.name


def _is_free_stream(system: System, name: str) -> bool:
    """A port of a stream that no DMA engine serves."""
    streams = [bus for region in system.regions for bus in region.streams if bus.external]
    return any(name.startswith(f"axis_{bus.name}_t") for bus in streams)


def _missing(system: System, inner: dict[str, str | None]) -> Iterator[tuple[str, str]]:
    """Yield signals that the block design's AXI slave ports need but the module does not have."""
    for region in system.regions:
        for interface in region.memory:
            if interface.protocol == "axi4lite":
                continue
            size = ((interface.data_width or 32) // 8).bit_length() - 1
            fills = {"size": f"3'd{size}", "burst": "2'b01", "len": zeros(8), "cache": "4'b0011", "prot": zeros(3)}
            for channel, there in (("aw", interface.writes), ("ar", interface.reads)):
                for signal, value in fills.items():
                    name = f"{region.name}_{interface.name}_{channel}{signal}"
                    if there and f"m_axi_{name}" not in inner:
                        yield f"s_axi_{name}", value
