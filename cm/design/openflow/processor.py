# SPDX-License-Identifier: Apache-2.0
"""The processing system of a Zynq-7000, in place of the block design that needs the vendor's tool.

It has one clock, its reset, one master port as AXI4-Lite, interrupts, and as many memory ports (HP0 to HP3: AXI3, 64
bits) as the DMA engines need. DDR and MIO pins are dedicated to the processing system and need no wires here.
"""

from __future__ import annotations

from dataclasses import dataclass

from cm.design.generate.axi import LITE
from cm.design.generate.netlist import Netlist, zeros
from cm.design.hdl.model import PortDirection

IN, OUT = PortDirection.IN, PortDirection.OUT
INTERRUPTS = 16  # of the PL
MEMORY_PORTS = 4
WORD = 8  # bytes, of a memory port

Pins = tuple[tuple[str, int], ...]
_FROM_GP: Pins = (
    *(("awaddr", 32), ("awid", 12), ("awvalid", 1), ("wdata", 32), ("wstrb", 4), ("wlast", 1), ("wvalid", 1)),
    *(("bready", 1), ("araddr", 32), ("arid", 12), ("arlen", 4), ("arvalid", 1), ("rready", 1)),
)
_TO_GP: Pins = (
    *(("awready", 1), ("wready", 1), ("bid", 12), ("bresp", 2), ("bvalid", 1), ("arready", 1)),
    *(("rdata", 32), ("rid", 12), ("rresp", 2), ("rlast", 1), ("rvalid", 1)),
)


@dataclass(frozen=True, slots=True)
class Half:
    """The read or the write half of a memory port, as seen by its master."""

    asks: Pins
    answers: Pins
    constants: tuple[tuple[str, str], ...]  # words of 64 bits, rising addresses, bufferable


READ = Half(
    (("araddr", 32), ("arlen", 4), ("arvalid", 1), ("rready", 1)),
    (("arready", 1), ("rdata", 64), ("rresp", 2), ("rlast", 1), ("rvalid", 1)),
    (("arsize", "2'b11"), ("arburst", "2'b01"), ("arcache", "4'b0011")),
)
WRITE = Half(
    (
        *(("awaddr", 32), ("awlen", 4), ("awvalid", 1)),
        *(("wdata", 64), ("wstrb", 8), ("wlast", 1), ("wvalid", 1), ("bready", 1)),
    ),
    (("awready", 1), ("wready", 1), ("bresp", 2), ("bvalid", 1)),
    (("awsize", "2'b11"), ("awburst", "2'b01"), ("awcache", "4'b0011")),
)


def memory_pin(number: int, signal: str) -> str:
    """The port of ``cm_open_system`` for a signal of a memory port."""
    return f"s_axi_hp{number}_{signal}"


def processing_system(reads: int, writes: int) -> Netlist:
    """``cm_open_system`` with the read halves of the first `reads` memory ports and the write halves of `writes`."""
    net = Netlist("cm_open_system", "The processing system for the open flow: clock, registers, memory, interrupts.")
    net.port("clk", OUT)
    net.port("resetn", OUT)
    net.port("irq", IN, INTERRUPTS)
    for name, direction, width in LITE:  # seen from the static part there
        net.port(f"m_axi_{name}", OUT if direction is IN else IN, width)
    net.wire("fclk", 4)
    net.wire("fresetn", 4)
    net.unused += ["fclk[3:1]", "fresetn[3:1]"]
    pins: dict[str, str | None] = {"FCLKCLK": "fclk", "FCLKRESETN": "fresetn", "IRQF2P": f"{{{zeros(4)}, irq}}"}
    pins["MAXIGP0ACLK"] = "clk"
    bridge: dict[str, str | None] = {"clk": "clk", "resetn": "resetn"}
    for name, width in (*_FROM_GP, *_TO_GP):
        pins[f"MAXIGP0{name.upper()}"] = bridge[f"s_{name}"] = net.wire(f"gp_{name}", width)
    bridge |= {f"m_{name}": f"m_axi_{name}" for name, _, _ in LITE}
    for number in range(max(reads, writes)):
        pins[f"SAXIHP{number}ACLK"] = "clk"
    for half, count in ((READ, reads), (WRITE, writes)):
        for number in range(count):
            pins |= _half(net, half, number)
    net.instance("PS7", "ps7", pins)
    net.instance("BUFG", "cm_clock_buffer", {"I": "fclk[0]", "O": "clk"})
    reset: dict[str, str | None] = {"clk": "clk", "d": "fresetn[0]", "q": "resetn"}
    net.instance("cm_sync", "sync_reset", reset, {"WIDTH": 1}, "The fabric's reset falls at any time")
    net.instance("cm_gp_lite", "bridge", bridge)
    return net


def _half(net: Netlist, half: Half, number: int) -> dict[str, str | None]:
    """Make half a port a port of the netlist, and return its pins."""
    pins: dict[str, str | None] = {f"SAXIHP{number}{name.upper()}": value for name, value in half.constants}
    for direction, listed in ((IN, half.asks), (OUT, half.answers)):
        for name, width in listed:
            pins[f"SAXIHP{number}{name.upper()}"] = net.port(memory_pin(number, name), direction, width)
    return pins
