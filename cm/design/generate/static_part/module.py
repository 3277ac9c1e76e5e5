# SPDX-License-Identifier: Apache-2.0
"""The static part in Verilog: regions, the logic between them and the block design, and the control registers."""

from __future__ import annotations

from cm.design.generate.axi import LITE, PER_SLAVE, SHARED, decoded, slave_pins
from cm.design.generate.static_part.region import add_region
from cm.design.generate.static_part.shared import add_shared
from cm.design.generate.verilog_module import Netlist, zeros
from cm.design.hdl.model import PortDirection
from cm.design.plan.system import Domain, System, used_clocks

IN, OUT = PortDirection.IN, PortDirection.OUT


def static_part(system: System) -> Netlist:
    """The module ``cm_static``."""
    net = Netlist("cm_static", f"Static part of {system.project.name}: decoupled regions behind the block design.")
    for clock in used_clocks(system):
        net.port(f"clk_{clock}", IN)
        net.port(f"resetn_{clock}", IN)
    for domain in system.domains:
        _interconnect(net, domain)
    _control(net, system)
    for region in system.regions:
        add_region(net, system, region)
    add_shared(net, system)
    if system.icap:
        _icap(net, system)
    return net


def _interconnect(net: Netlist, domain: Domain) -> None:
    """The register windows of one clock behind one AXI4-Lite port."""
    count, name = len(domain.windows), domain.clock
    connections: dict[str, str | None] = {"clk": f"clk_{name}", "resetn": f"resetn_{name}"}
    for signal, direction, width in LITE:
        connections[f"s_{signal}"] = net.port(f"s_axi_{name}_{signal}", direction, width)
        per_slave = width if signal in SHARED else count * PER_SLAVE.get(signal, 1)
        connections[f"m_{signal}"] = net.wire(f"{name}_{signal}", per_slave)
    listed = ", ".join(f"{window.name} {window.base:#010x}" for window in domain.windows)
    comment = f"Registers on {name}: {listed}"
    net.instance("cm_axil_interconnect", f"interconnect_{name}", connections, decoded(domain.windows), comment)


def _control(net: Netlist, system: System) -> None:
    domain = system.domains[0]
    count, lines = len(system.regions), len(system.lines)
    for name in ("decouple", "region_reset", "decoupled", "stuck"):
        net.wire(name, count, indexed=True)
    net.wire("identity", 32 * count)
    net.wire("irq_lines", max(1, lines), indexed=True)
    if not lines:
        net.assign("irq_lines", "1'b0")
    net.wire("icap_status", 3)
    net.wire("icap_words", 32)
    if not system.icap:
        net.assign("icap_status", zeros(3))
        net.assign("icap_words", zeros(32))
    connections: dict[str, str | None] = {"clk": f"clk_{domain.clock}", "resetn": f"resetn_{domain.clock}"}
    connections |= slave_pins(domain, "control")
    for name in ("decouple", "region_reset", "decoupled", "stuck", "identity", "icap_status", "icap_words"):
        connections[name] = name
    connections["irq_lines"] = "irq_lines"
    connections["irq"] = net.port("irq", OUT)
    edges = "".join("1" if line.edge else "0" for line in reversed(system.lines)) or "0"
    parameters = {"REGIONS": count, "IRQS": max(1, lines), "IRQ_EDGE": f"{max(1, lines)}'b{edges}"}
    parameters["STATIC_ID"] = f"32'h{system.static_identity:08X}"
    net.instance("cm_control", "control", connections, parameters, "Control registers")
    net.unused += [f"{entry.clock}_{signal}" for entry in system.domains for signal in SHARED if signal[0] == "a"]


def _icap(net: Netlist, system: System) -> None:
    assert system.icap is not None
    clock = system.icap.clock
    connections: dict[str, str | None] = {"clk": f"clk_{clock}", "resetn": f"resetn_{clock}"}
    for signal, direction, width in (("tvalid", IN, 1), ("tready", OUT, 1), ("tdata", IN, 32), ("tlast", IN, 1)):
        connections[f"s_{signal}"] = net.port(f"axis_icap_{signal}", direction, width)
    connections |= {"status": "icap_status", "words": "icap_words"}
    parameters = {"ULTRASCALE": int(system.platform.ultrascale)}
    if system.readback:
        for signal, direction, width in (("tvalid", OUT, 1), ("tready", IN, 1), ("tdata", OUT, 32), ("tlast", OUT, 1)):
            connections[f"m_{signal}"] = net.port(f"axis_{system.readback.name}_{signal}", direction, width)
    kind = "cm_icap_read" if system.readback else "cm_icap"
    net.instance(kind, "icap", connections, parameters, "Configuration port")
