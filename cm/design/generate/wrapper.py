# SPDX-License-Identifier: Apache-2.0
"""A module's wrapper to its region's boundary, and the region's black box.

All wrappers of a region are Verilog modules with the same name, that of the black box, each in its own file.
"""

from __future__ import annotations

from cm.design.boundary.model import Adaptation, Connection, Fit
from cm.design.errors import BuildError
from cm.design.generate import axi
from cm.design.generate.verilog_module import Netlist, low_bits, ones, zeros
from cm.design.hdl.model import Interface, Mode, PortDirection
from cm.design.plan.system import Implementation, RegionPlan
from cm.design.project.model import ModuleSpec

IN, OUT = PortDirection.IN, PortDirection.OUT


def black_box(region: RegionPlan) -> Netlist:
    """The region as the static part sees it: ports only."""
    net = Netlist(region.module, f"Black box of region {region.name}: its modules come as checkpoints.", True)
    _ports(net, region)
    return net


def wrapper(implementation: Implementation) -> Netlist:
    """``cm_region_<region>`` around the module; BuildError if it does not fit."""
    module, region = implementation.module, implementation.region
    adaptation = region.boundary.adaptation(module.name)
    if not adaptation.ok:
        raise BuildError(f"{module.name} does not fit region {region.name}: {'; '.join(adaptation.refused)}")
    net = Netlist(region.module, f"Module {module.name} ({module.top}) fitted to the boundary of region {region.name}.")
    _ports(net, region)
    net.assign("cm_identity", f"32'h{implementation.identity:08X}")
    absent = _absent_slaves(region, adaptation)
    skipped = {port for interface in absent for port in interface.ports.values()}
    pins: dict[str, str | None] = {}
    offsets = _offset_bits(region)
    for connection in adaptation.connections:
        if connection.boundary not in skipped:
            _connect(net, connection, pins, offsets)
    for interface in absent:
        _refuse(net, region, interface)
    net.instance(module.top, "inner", pins, _parameters(module), f"{module.name}")
    return net


def _ports(net: Netlist, region: RegionPlan) -> None:
    for port in region.boundary.ports:
        net.port(port.name, port.direction, port.width)
    net.port("cm_identity", OUT, 32)


def _parameters(module: ModuleSpec) -> dict[str, object]:
    return {name: _literal(value) for name, value in module.parameters.items()}


def _literal(value: object) -> str:
    if isinstance(value, bool):
        return "1'b1" if value else "1'b0"
    if isinstance(value, str):
        # "8'hFF" is a Verilog number, anything else text
        return value if "'" in value else f'"{value}"'
    if isinstance(value, int) and value >> 31 > 0:  # as a plain number it has 32 bits with a sign (IEEE 1364, 3.5.1)
        return f"{value.bit_length()}'d{value}"
    return str(value)


def _offset_bits(region: RegionPlan) -> dict[str, int]:
    """How many bits of each address say where in the slave's window: where a region's window is, no module knows."""
    return {
        bus.interface.ports[name]: (bus.window.size - 1).bit_length()
        for bus in region.registers
        for name in ("AWADDR", "ARADDR")
        if name in bus.interface.ports
    }


def _connect(net: Netlist, connection: Connection, pins: dict[str, str | None], offsets: dict[str, int]) -> None:
    fit, have, want = connection.fit, connection.module_width, connection.boundary_width
    if not connection.module:  # a boundary port that the module does not have
        if connection.direction is OUT:
            net.assign(connection.boundary, (ones if connection.value else zeros)(want))
        elif connection.direction is IN:
            net.unused.append(connection.boundary)
    elif not connection.boundary and fit is Fit.OPEN and connection.direction is IN:
        return  # the HDL's default counts where the port is not named at all (IEEE 1800, 23.3.2.2)
    elif not connection.boundary:  # a module port that the boundary does not have
        tied = (ones if connection.value else zeros)(have) if fit is Fit.TIE else None
        pins[connection.module] = tied
    elif connection.direction is IN:
        _connect_input(net, connection, pins, offsets)
    elif connection.direction is OUT and have != want:
        wire = net.wire(f"module_{connection.module}", have)
        pins[connection.module] = wire
        net.assign(connection.boundary, low_bits(wire, have, want))
        if have > want:
            net.unused.append(f"{wire}[{have - 1}:{want}]")
    elif fit is Fit.INVERT:
        pins[connection.module] = net.wire(f"module_{connection.module}", have)
        net.assign(connection.boundary, f"~module_{connection.module}")
    else:
        pins[connection.module] = connection.boundary


def _connect_input(net: Netlist, connection: Connection, pins: dict[str, str | None], offsets: dict[str, int]) -> None:
    have, want = connection.module_width, connection.boundary_width
    read = min(have, want, offsets.get(connection.boundary, want))
    source = low_bits(low_bits(connection.boundary, want, read), read, have)
    pins[connection.module] = f"~{source}" if connection.fit is Fit.INVERT else source
    if want > read:
        net.unused.append(f"{connection.boundary}[{want - 1}:{read}]")


def _absent_slaves(region: RegionPlan, adaptation: Adaptation) -> list[Interface]:
    """AXI slaves of the boundary that this module does not have: a stub must answer there."""
    present = {connection.boundary for connection in adaptation.connections if connection.module}
    return [
        interface
        for interface in region.boundary.interfaces
        if interface.mode is Mode.SLAVE
        and interface.protocol in ("axi4", "axi4lite")
        and not any(port in present for port in interface.ports.values())
    ]


def _refuse(net: Netlist, region: RegionPlan, interface: Interface) -> None:
    """Answer every access to `interface` with SLVERR."""
    clock, reset = interface.clock, interface.reset
    if clock is None or reset is None:
        raise BuildError(f"{region.name}.{interface.name} has no clock or reset at the boundary")
    width = axi.width_of(interface, "RDATA") if interface.reads else 1
    ids = axi.id_width(interface)
    pins: dict[str, str | None] = {"clk": clock, "resetn": reset, "decouple": "1'b1", "clear": "1'b0"}
    pins |= {"decoupled": None, "stuck": None}
    given = {"AWVALID": "1'b0", "AWLEN": zeros(8), "AWID": zeros(ids), "WVALID": "1'b0", "WLAST": "1'b1"}
    given |= {"BREADY": "1'b1", "ARVALID": "1'b0", "ARLEN": zeros(8), "ARID": zeros(ids), "RREADY": "1'b1"}
    pins |= {f"s_{name.lower()}": interface.ports.get(name, missing) for name, missing in given.items()}
    for name in ("AWREADY", "WREADY", "BVALID", "BRESP", "BID", "ARREADY", "RVALID", "RRESP", "RLAST", "RID"):
        pins[f"s_{name.lower()}"] = interface.ports.get(name)
    pins["s_rpayload"] = interface.ports.get("RDATA")
    for channel in ("aw", "w", "ar"):
        pins[f"s_{channel}payload"] = "1'b0"
        pins[f"m_{channel}payload"] = None
    for name in ("awvalid", "awlen", "awid", "wvalid", "wlast", "bready", "arvalid", "arlen", "arid", "rready"):
        pins[f"m_{name}"] = None
    for name in ("awready", "wready", "bvalid", "arready", "rvalid"):
        pins[f"m_{name}"] = "1'b0"
    pins |= {"m_bresp": "2'b00", "m_rresp": "2'b00", "m_rpayload": zeros(width)}
    parameters = {"AW_WIDTH": 1, "W_WIDTH": 1, "AR_WIDTH": 1, "R_WIDTH": width, "ID_WIDTH": ids}
    comment = f"{interface.name}: the module has no such slave, accesses end with SLVERR"
    net.instance("cm_axi_slave_decoupler", f"absent_{interface.name}", pins, parameters, comment)
    used = {text for text in pins.values() if text}
    for logical, port in interface.ports.items():
        if port in used:
            continue
        if logical in axi.FROM_SLAVE:
            net.assign(port, zeros(axi.width_of(interface, logical)))
        else:
            net.unused.append(port)
