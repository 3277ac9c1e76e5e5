# SPDX-License-Identifier: Apache-2.0
"""One region of the static part: black box, reset, decouplers, what its ports are connected to."""

from __future__ import annotations

from cm.build import axi
from cm.build.boundary.model import Role
from cm.build.hdl.model import Interface, PortDirection
from cm.build.lite import LITE, slave_port
from cm.build.netlist import Netlist, concat, low_bits, ones, zeros
from cm.build.system import MemoryBus, RegionPlan, RegisterBus, StreamBus, System

IN, OUT, INOUT = PortDirection.IN, PortDirection.OUT, PortDirection.INOUT


class RegionBuilder:
    """Adds a region to the static part."""

    def __init__(self, net: Netlist, system: System, region: RegionPlan) -> None:
        self._net, self._system, self._region = net, system, region
        self._clock, self._reset = f"clk_{region.spec.clock}", f"resetn_{region.spec.clock}"
        self._name = region.name
        self._cut = f"{self._name}_cut"
        self._drained: list[str] = []
        self._stuck: list[str] = []
        self._done: set[str] = set()  # boundary ports that are connected

    def build(self) -> None:
        """Everything, in the order in which the file reads well."""
        self._declare()
        self._control()
        for registers in self._region.registers:
            self._registers(registers)
        for stream in self._region.streams:
            self._stream(stream)
        for memory in self._region.memory:
            self._memory(memory)
        self._interrupts()
        self._external()
        self._rest()
        index = self._region.index
        self._sync("decoupled", f"{self._cut} && " + " && ".join(self._drained) if self._drained else self._cut, index)
        self._sync("stuck", " || ".join(self._stuck) or "1'b0", index)

    def _wire(self, port: str) -> str:
        """The wire at a boundary port."""
        return f"{self._name}_{port}"

    def _declare(self) -> None:
        net, region = self._net, self._region
        connections: dict[str, str | None] = {}
        for port in region.boundary.ports:
            width = port.width
            if port.direction is INOUT:
                connections[port.name] = net.port(f"ext_{self._wire(port.name)}", INOUT, width)
            else:
                connections[port.name] = net.wire(self._wire(port.name), width)
        connections["cm_identity"] = net.wire(self._wire("cm_identity"), 32)
        net.instance(region.module, self._name, connections, comment=f"Region {self._name}")

    def _control(self) -> None:
        """Decoupling and reset, brought to the region's clock; identity, brought back."""
        net, index = self._net, self._region.index
        request, hold = net.wire(f"{self._name}_request", 2), net.wire(f"{self._name}_hold")
        reset, busy = net.wire(f"{self._name}_resetn_out"), net.wire(f"{self._name}_busy")
        net.wire(self._cut)
        self._cm_sync(f"{self._name}_request", self._clock, f"{{region_reset[{index}], decouple[{index}]}}", request, 2)
        net.assign(hold, f"|{request}")
        connections: dict[str, str | None] = {"clk": self._clock, "resetn": self._reset, "hold": hold}
        connections |= {"region_resetn": reset, "busy": busy}
        net.instance("cm_region_reset", f"{self._name}_reset", connections)
        net.assign(self._cut, busy if self._region.spec.decoupling else "1'b0")
        if not self._region.spec.decoupling:
            net.unused.append(busy)
        for port in self._region.boundary.ports:
            if port.role is Role.CLOCK and port.direction is IN:
                net.assign(self._wire(port.name), self._clock)
                self._done.add(port.name)
            elif port.role is Role.RESET and port.direction is IN:
                net.assign(self._wire(port.name), reset)
                self._done.add(port.name)
        known = net.wire(f"{self._name}_known", 32)
        net.assign(known, f"{self._wire('cm_identity')} & {{32{{!{self._cut}}}}}")
        self._cm_sync(f"{self._name}_identity", self._main, known, f"identity[{32 * index}+:32]", 32)

    @property
    def _main(self) -> str:
        return f"clk_{self._system.domains[0].clock}"

    def _cm_sync(self, name: str, clock: str, source: str, target: str, width: int = 1) -> None:
        connections: dict[str, str | None] = {"clk": clock, "d": source, "q": target}
        self._net.instance("cm_sync", f"sync_{name}", connections, {"WIDTH": width})

    def _sync(self, target: str, expression: str, index: int) -> None:
        """A bit of the region to the control registers."""
        wire = self._net.wire(f"{self._name}_{target}")
        self._net.assign(wire, expression)
        self._cm_sync(f"{self._name}_{target}", self._main, wire, f"{target}[{index}]")

    def _pin(self, interface: Interface, logical: str, missing: str | None) -> str | None:
        """The region's wire of a signal, or what stands for it."""
        if logical not in interface.ports:
            return missing
        port = interface.ports[logical]
        self._done.add(port)
        return self._wire(port)

    def _decoupler(
        self, kind: str, interface: Interface, connections: dict[str, str | None], **parameters: object
    ) -> None:
        drained = self._net.wire(f"{self._name}_{interface.name}_drained")
        self._drained.append(drained)
        common: dict[str, str | None] = {"clk": self._clock, "resetn": self._reset, "decouple": self._cut}
        common["decoupled"] = drained
        comment = f"{self._name}.{interface.name}: {interface.protocol} {interface.mode.value}"
        name = f"{self._name}_{interface.name}_decoupler"
        self._net.instance(kind, name, common | connections, parameters, comment)

    # registers -------------------------------------------------------------------------------

    def _registers(self, bus: RegisterBus) -> None:
        interface = bus.interface
        stuck = self._net.wire(f"{self._name}_{interface.name}_stuck")
        self._stuck.append(stuck)
        connections: dict[str, str | None] = {"clear": f"!{self._name}_resetn_out", "stuck": stuck}
        parameters: dict[str, object] = {"ID_WIDTH": self._id_width(interface)}
        outside = _Outside(self._net, self._system, self._region, bus)
        for channel, kinds in (("AW", axi.ADDRESS), ("W", ("DATA", "STRB")), ("AR", axi.ADDRESS)):
            packed = axi.fields(interface, kinds, channel)
            lane = channel.lower()
            inside = concat(self._take(field) for field in packed) if packed else None
            parameters[f"{channel}_WIDTH"] = sum(field.width for field in packed) or 1
            connections[f"s_{lane}payload"] = concat(outside.into(field) for field in packed) if packed else "1'b0"
            connections[f"m_{lane}payload"] = inside
        width = axi.width_of(interface, "RDATA") if interface.reads else 1
        parameters["R_WIDTH"] = width
        connections["m_rpayload"] = self._pin(interface, "RDATA", zeros(width))
        connections["s_rpayload"] = outside.signal("RDATA", width)
        connections |= self._handshakes(interface) | outside.handshakes(parameters["ID_WIDTH"])
        self._decoupler("cm_axi_slave_decoupler", interface, connections, **parameters)

    def _take(self, field: axi.Field) -> str:
        self._done.add(field.port)
        return self._wire(field.port)

    @staticmethod
    def _id_width(interface: Interface) -> int:
        return max((interface.widths.get(name) or 1 for name in ("AWID", "ARID")), default=1)

    def _handshakes(self, interface: Interface) -> dict[str, str | None]:
        """Region side of a slave; a channel that it has not answers at once with SLVERR."""
        pins: dict[str, str | None] = {}
        for name in ("AWVALID", "AWLEN", "AWID", "WVALID", "WLAST", "BREADY", "ARVALID", "ARLEN", "ARID", "RREADY"):
            pins[f"m_{name.lower()}"] = self._pin(interface, name, None)
        for name in ("AWREADY", "WREADY", "BVALID", "ARREADY", "RVALID"):
            pins[f"m_{name.lower()}"] = self._pin(interface, name, "1'b1")
        pins["m_bresp"] = self._pin(interface, "BRESP", "2'b00" if interface.writes else "2'b10")
        pins["m_rresp"] = self._pin(interface, "RRESP", "2'b00" if interface.reads else "2'b10")
        return pins

    # streams ---------------------------------------------------------------------------------

    def _stream(self, bus: StreamBus) -> None:
        interface = bus.interface
        sends = interface.mode.value == "master"
        kept = ("TDATA", "TKEEP") if bus.dma else axi.STREAM
        packed = axi.fields(interface, kept)
        inside = concat(self._take(field) for field in packed)
        outside = concat(self._stream_port(bus, field, sends) for field in packed)
        last = "TLAST" in interface.ports
        region, static = ("s", "m") if sends else ("m", "s")
        connections: dict[str, str | None] = {
            f"{region}_tvalid": self._pin(interface, "TVALID", "1'b1"),
            f"{region}_tready": self._pin(interface, "TREADY", None if sends else "1'b1"),
            f"{region}_tlast": self._pin(interface, "TLAST", "1'b0" if sends else None),
            f"{region}_tpayload": inside,
            f"{static}_tpayload": outside,
        }
        direction, back = (OUT, IN) if sends else (IN, OUT)
        connections[f"{static}_tvalid"] = self._net.port(f"axis_{bus.name}_tvalid", direction)
        connections[f"{static}_tready"] = self._net.port(f"axis_{bus.name}_tready", back)
        connections[f"{static}_tlast"] = self._net.port(f"axis_{bus.name}_tlast", direction)
        parameters: dict[str, object] = {"PAYLOAD_WIDTH": sum(field.width for field in packed), "HAS_LAST": int(last)}
        if sends:
            closing = concat(ones(f.width) if f.logical in ("TKEEP", "TSTRB") else zeros(f.width) for f in packed)
            parameters["CLOSING"] = closing
        kind = "cm_axis_master_decoupler" if sends else "cm_axis_slave_decoupler"
        self._decoupler(kind, interface, connections, **parameters)

    def _stream_port(self, bus: StreamBus, field: axi.Field, sends: bool) -> str:
        """The static part's port of a signal; a DMA's is as wide as its data, the bits above are zero."""
        width = field.width
        if bus.dma:
            width = bus.dma.width if field.logical == "TDATA" else bus.dma.width // 8
        name = self._net.port(f"axis_{bus.name}_{field.logical.lower()}", OUT if sends else IN, width)
        used = low_bits(name, width, field.width)
        if width > field.width:
            rest = f"{name}[{width - 1}:{field.width}]"
            if sends:
                fill = ones if field.logical == "TKEEP" else zeros
                self._net.assign(rest, fill(width - field.width))
            else:
                self._net.unused.append(rest)
        return used

    # memory ----------------------------------------------------------------------------------

    def _memory(self, bus: MemoryBus) -> None:
        interface = bus.interface
        data = axi.width_of(interface, "WDATA" if interface.writes else "RDATA")
        connections: dict[str, str | None] = {}
        parameters: dict[str, object] = {"DATA_WIDTH": data}
        groups = {
            "AW": axi.fields(interface, (*axi.ADDRESS, "ID"), "AW"),
            "AR": axi.fields(interface, (*axi.ADDRESS, "LEN", "ID"), "AR"),
            "B": axi.fields(interface, ("RESP", "ID"), "B"),
            "R": axi.fields(interface, ("DATA", "RESP", "ID"), "R"),
        }
        for channel, packed in groups.items():
            lane = f"{channel.lower()}payload"
            parameters[f"{channel}_WIDTH"] = sum(field.width for field in packed) or 1
            into = channel in ("AW", "AR")
            inside = concat(self._take(field) for field in packed) if packed else ("1'b0" if into else None)
            outside = concat(self._memory_port(interface, field) for field in packed) if packed else None
            connections[f"s_{lane}"] = inside
            connections[f"m_{lane}"] = outside if outside or into else "1'b0"
        connections |= self._memory_handshakes(interface, data)
        self._decoupler("cm_axi_master_decoupler", interface, connections, **parameters)

    def _memory_port(self, interface: Interface, field: axi.Field) -> str:
        name = f"m_axi_{self._name}_{interface.name}_{field.logical.lower()}"
        direction = IN if field.logical in axi.FROM_SLAVE else OUT
        return self._net.port(name, direction, field.width)

    def _memory_handshakes(self, interface: Interface, data: int) -> dict[str, str | None]:
        pins: dict[str, str | None] = {}
        widths = {"AWLEN": 8, "WDATA": data, "WSTRB": data // 8}
        tied = {"AWLEN": zeros(8), "WDATA": zeros(data), "WSTRB": ones(data // 8), "RLAST": "1'b1"}
        from_region = ("AWVALID", "AWLEN", "WVALID", "WDATA", "WSTRB", "BREADY", "ARVALID", "RREADY")
        to_region = ("AWREADY", "WREADY", "BVALID", "ARREADY", "RVALID", "RLAST")
        for name in (*from_region, *to_region):
            missing = tied.get(name, "1'b0") if name in from_region else None
            pins[f"s_{name.lower()}"] = self._pin(interface, name, missing)
        for name in (*from_region, "WLAST", *to_region):
            present = name in interface.ports
            field = axi.Field(name, "", widths.get(name, 1))
            missing = tied.get(name, "1'b0") if name in to_region else None
            pins[f"m_{name.lower()}"] = self._memory_port(interface, field) if present else missing
        if "WLAST" in interface.ports:
            self._done.add(interface.ports["WLAST"])  # the decoupler counts the beats itself
            self._net.unused.append(self._wire(interface.ports["WLAST"]))
        return pins

    # the rest --------------------------------------------------------------------------------

    def _interrupts(self) -> None:
        """Interrupt lines, silent while the region is cut off, long enough for the control registers' clock."""
        by_port: dict[str, int] = {line.port: 0 for line in self._region.lines}
        cycles = self._stretch()
        for port in by_port:
            width = next(p.width for p in self._region.boundary.ports if p.name == port)
            gated = self._net.wire(f"{self._name}_{port}_gated", width)
            self._net.assign(gated, f"{self._wire(port)} & {{{width}{{!{self._cut}}}}}")
            self._done.add(port)
            source = gated
            if cycles:
                source = self._net.wire(f"{self._name}_{port}_long", width)
                connections: dict[str, str | None] = {
                    "clk": self._clock,
                    "resetn": self._reset,
                    "d": gated,
                    "q": source,
                }
                self._net.instance(
                    "cm_stretch", f"{self._name}_{port}_stretch", connections, {"WIDTH": width, "CYCLES": cycles}
                )
            for line in self._region.lines:
                if line.port == port:
                    self._net.assign(f"irq_lines[{line.bit}]", source if width == 1 else f"{source}[{line.index}]")

    def _stretch(self) -> int:
        """Clocks of the region that the control registers' clock cannot miss; 0 on the same clock."""
        own, main = self._system.project.clocks[self._region.spec.clock], self._system.domains[0]
        return 0 if own.name == main.clock else min(255, 2 * -(-own.rate // main.rate) + 2)

    def _external(self) -> None:
        """Ports of the top; outputs read as idle while the region is cut off."""
        for port in self._region.external:
            self._done.add(port.name)
            if port.direction is INOUT:
                continue
            name = self._net.port(f"ext_{self._wire(port.name)}", port.direction, port.width)
            if port.direction is IN:
                self._net.assign(self._wire(port.name), name)
            elif port.idle:
                self._net.assign(name, f"{self._wire(port.name)} | {{{port.width}{{{self._cut}}}}}")
            else:
                self._net.assign(name, f"{self._wire(port.name)} & {{{port.width}{{!{self._cut}}}}}")

    def _rest(self) -> None:
        """Inputs that nothing drives are 0 (TSTRB: 1), outputs that nothing reads are marked."""
        for port in self._region.boundary.ports:
            if port.name in self._done or port.direction is INOUT:
                continue
            if port.direction is IN:
                fill = ones if port.logical == "TSTRB" else zeros
                self._net.assign(self._wire(port.name), fill(port.width))
            else:
                self._net.unused.append(self._wire(port.name))


class _Outside:
    """Where a register bus meets the static part: the interconnect, or ports to the block design."""

    def __init__(self, net: Netlist, system: System, region: RegionPlan, bus: RegisterBus) -> None:
        self._net, self._system, self._region, self._bus = net, system, region, bus

    def signal(self, logical: str, width: int) -> str:
        """The static side's signal, `width` bits of it."""
        signal = logical.lower()
        if self._bus.full:
            name = f"s_axi_{self._region.name}_{self._bus.interface.name}_{signal}"
            return self._net.port(name, OUT if logical in axi.FROM_SLAVE else IN, width)
        domain = next(d for d in self._system.domains if d.clock == self._region.spec.clock)
        have = next(bits for known, _, bits in LITE if known == signal)
        return low_bits(slave_port(domain, self._bus.window.name, signal), have, width)

    def into(self, field: axi.Field) -> str:
        """A payload's signal on its way to the region."""
        return self.signal(field.logical, field.width)

    def handshakes(self, id_width: object) -> dict[str, str | None]:
        """Static side of the handshakes."""
        assert isinstance(id_width, int)
        pins: dict[str, str | None] = {}
        for name in ("AWVALID", "AWREADY", "WVALID", "WREADY", "BVALID", "BREADY"):
            pins[f"s_{name.lower()}"] = self.signal(name, 1)
        for name in ("ARVALID", "ARREADY", "RVALID", "RREADY"):
            pins[f"s_{name.lower()}"] = self.signal(name, 1)
        pins["s_bresp"], pins["s_rresp"] = self.signal("BRESP", 2), self.signal("RRESP", 2)
        full = self._bus.full and self._bus.interface.protocol != "axi4lite"
        pins["s_awlen"] = self.signal("AWLEN", 8) if full else zeros(8)
        pins["s_arlen"] = self.signal("ARLEN", 8) if full else zeros(8)
        pins["s_wlast"] = self.signal("WLAST", 1) if full else "1'b1"
        pins["s_rlast"] = self.signal("RLAST", 1) if full else None
        for name in ("awid", "arid"):
            pins[f"s_{name}"] = self.signal(name.upper(), id_width) if full else zeros(id_width)
        for name in ("bid", "rid"):
            pins[f"s_{name}"] = self.signal(name.upper(), id_width) if full else None
        return pins
