# SPDX-License-Identifier: Apache-2.0
"""The interface between a region and the static part, shared by the builders of its decouplers."""

from __future__ import annotations

from copy import copy

from cm.design.boundary.scalar_signals import reset_of
from cm.design.generate import axi
from cm.design.generate.verilog_module import Netlist
from cm.design.hdl.model import Interface
from cm.design.plan.system import RegionPlan, System


class Site:
    """A region in the netlist that is being built; `done` are the boundary's ports that are connected."""

    def __init__(self, net: Netlist, system: System, region: RegionPlan) -> None:
        self.net, self.system, self.region = net, system, region
        self.clock, self.reset = f"clk_{region.spec.clock}", f"resetn_{region.spec.clock}"
        self.name = region.name
        self.cut = f"{self.name}_cut"
        self.region_reset = f"{self.name}_resetn_out"  # of the modules, active low, on `clock`
        self._others: dict[str, Site] = {}
        self.drained: list[str] = []
        self.stuck: list[str] = []
        self.done: set[str] = set()

    def wire(self, port: str) -> str:
        """The wire at a boundary port."""
        return f"{self.name}_{port}"

    @property
    def main(self) -> str:
        """The clock of the control registers."""
        return f"clk_{self.system.domains[0].clock}"

    def at(self, interface: Interface) -> Site:
        """The site as an interface sees it: with its own clock, to which what cuts the region off is synchronised."""
        clock = self.region.clock_of(interface)
        if clock == self.region.spec.clock:
            return self
        if clock not in self._others:
            other = copy(self)
            other.clock, other.reset, other.cut = f"clk_{clock}", f"resetn_{clock}", f"{self.cut}_{clock}"
            other.region_reset = self.wire(reset_of(interface.clock or ""))
            other.drained, other.stuck = [], []
            self.net.wire(other.cut)
            if self.region.spec.decoupling:
                # not only synchronised: the two synchronisers may differ by a clock, and a module in reset must not
                # be heard, nor be given a beat that it would lose
                asked = self.net.wire(f"{other.cut}_asked")
                self.cm_sync(other.cut, other.clock, self.cut, asked)
                self.net.assign(other.cut, f"{asked} || !{other.region_reset}")
            else:
                self.net.assign(other.cut, "1'b0")
            self._others[clock] = other
        return self._others[clock]

    def join(self) -> None:
        """Synchronise what the interfaces on other clocks say back to the region's."""
        for other in self._others.values():
            for mine, theirs in ((self.drained, other.drained), (self.stuck, other.stuck)):
                for signal in theirs:
                    here = self.net.wire(f"{signal}_here")
                    self.cm_sync(here, self.clock, signal, here)
                    mine.append(here)

    def cm_sync(self, name: str, clock: str, source: str, target: str, width: int = 1) -> None:
        """Synchronise levels to another clock."""
        connections: dict[str, str | None] = {"clk": clock, "d": source, "q": target}
        self.net.instance("cm_sync", f"sync_{name}", connections, {"WIDTH": width})

    def to_control(self, target: str, expression: str, index: int) -> None:
        """Pass a bit of the region to the control registers."""
        wire = self.net.wire(f"{self.name}_{target}")
        self.net.assign(wire, expression)
        self.cm_sync(f"{self.name}_{target}", self.main, wire, f"{target}[{index}]")

    def pin(self, interface: Interface, logical: str, missing: str | None) -> str | None:
        """Return the region's wire of a signal, or `missing` if it has none."""
        if logical not in interface.ports:
            return missing
        port = interface.ports[logical]
        self.done.add(port)
        return self.wire(port)

    def decoupler(
        self, kind: str, interface: Interface, connections: dict[str, str | None], **parameters: object
    ) -> None:
        """Add the decoupler of an interface; the region counts as cut off when all of them are drained."""
        drained = self.net.wire(f"{self.name}_{interface.name}_drained")
        self.drained.append(drained)
        common: dict[str, str | None] = {"clk": self.clock, "resetn": self.reset, "decouple": self.cut}
        common["decoupled"] = drained
        comment = f"{self.name}.{interface.name}: {interface.protocol} {interface.mode.value}"
        name = f"{self.name}_{interface.name}_decoupler"
        self.net.instance(kind, name, common | connections, parameters, comment)

    def take(self, field: axi.Field) -> str:
        """Return the region's wire of a payload signal, and count it as connected."""
        self.done.add(field.port)
        return self.wire(field.port)
