# SPDX-License-Identifier: Apache-2.0
"""In the simulator: the static part with a register port, a stream into it and a stream out of it."""

from __future__ import annotations

import random

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiStreamBus, AxiStreamSink, AxiStreamSource
from protocol import Handshake, quiet


class StreamBoard:
    """Both streams pause at random, and the stream out is checked for the rules of its handshake."""

    def __init__(self, dut: object, into: str, out_of: str, seed: int, payload: tuple[str, ...] = ()) -> None:
        """`into`, `out_of`: prefixes of the streams' ports; `payload`: signals out of it beside TDATA, TKEEP, TLAST."""
        quiet()
        self.clk, self.reset = dut.clk_fclk0, dut.resetn_fclk0
        cocotb.start_soon(Clock(self.clk, 10, "ns").start())
        self.reset.value = 0
        dut.axis_icap_tvalid.value = 0
        ends = {"clock": self.clk, "reset": self.reset, "reset_active_level": False}
        self.registers = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi_fclk0"), **ends)
        self.source = AxiStreamSource(AxiStreamBus.from_prefix(dut, into), **ends)
        self.sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, out_of), **ends)
        watched = [f"{out_of}_{name}" for name in ("tdata", "tkeep", "tlast", *payload)]
        self.out = Handshake(dut, self.clk, self.reset, out_of, f"{out_of}_tvalid", f"{out_of}_tready", watched)
        chance = random.Random(seed)
        for end in (self.source, self.sink):
            end.set_pause_generator(iter(lambda: chance.random() < 0.3, None))

    async def start(self) -> None:
        """Release the reset, and wait until it has arrived everywhere."""
        await ClockCycles(self.clk, 5)
        self.reset.value = 1
        await ClockCycles(self.clk, 40)
