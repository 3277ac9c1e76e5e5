# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: a region of 24 bits between two DMA engines of 32; it inverts every byte."""

from __future__ import annotations

import os
import random

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiStreamBus, AxiStreamFrame, AxiStreamSink, AxiStreamSource
from protocol import Handshake, quiet

KEEP = os.environ["CM_KEEP"] == "1"
DECOUPLE, STATUS = 0x4000_0100, 0x4000_0108


class Board:
    def __init__(self, dut: object) -> None:
        quiet()
        self.clk, self.reset = dut.clk_fclk0, dut.resetn_fclk0
        cocotb.start_soon(Clock(self.clk, 10, "ns").start())
        self.reset.value = 0
        dut.axis_icap_tvalid.value = 0
        ends = {"clock": self.clk, "reset": self.reset, "reset_active_level": False}
        self.registers = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi_fclk0"), **ends)
        self.source = AxiStreamSource(AxiStreamBus.from_prefix(dut, "axis_prr0_s_axis"), **ends)
        self.sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, "axis_prr0_m_axis"), **ends)
        prefix = "axis_prr0_m_axis"
        payload = [f"{prefix}_{name}" for name in ("tdata", "tkeep", "tlast")]
        self.out = Handshake(dut, self.clk, self.reset, prefix, f"{prefix}_tvalid", f"{prefix}_tready", payload)
        chance = random.Random(5)
        for end in (self.source, self.sink):
            end.set_pause_generator(iter(lambda: chance.random() < 0.3, None))

    async def start(self) -> None:
        await ClockCycles(self.clk, 5)
        self.reset.value = 1
        await ClockCycles(self.clk, 40)

    async def round_trip(self, data: bytes) -> bytes:
        await self.source.send(AxiStreamFrame(data))
        return bytes((await with_timeout(self.sink.recv(), 200, "us")).tdata)


def inverted(data: bytes) -> bytes:
    return bytes(255 - byte for byte in data)


@cocotb.test()
async def every_byte_of_every_frame_comes_back(dut: object) -> None:
    board = Board(dut)
    await board.start()
    lengths = range(1, 40) if KEEP else range(3, 60, 3)
    for length in lengths:
        data = random.Random(length).randbytes(length)
        assert await board.round_trip(data) == inverted(data)
    assert not board.out.errors, board.out.errors[:3]


@cocotb.test()
async def a_frame_that_is_cut_off_leaves_nothing_for_the_next(dut: object) -> None:
    board = Board(dut)
    await board.start()
    for clocks in (30, 47, 64):
        await board.source.send(AxiStreamFrame(bytes(300)))
        await ClockCycles(board.clk, clocks)
        await board.registers.write(DECOUPLE, bytes((1, 0, 0, 0)))
        while not (await board.registers.read(STATUS, 4)).data[0] & 1:
            pass
        await board.registers.write(DECOUPLE, bytes(4))
        await board.source.wait()
        await ClockCycles(board.clk, 200)
        while not board.sink.empty():
            board.sink.recv_nowait()
        data = bytes(range(1, 61))
        assert await board.round_trip(data) == inverted(data)
    assert not board.out.errors, board.out.errors[:3]
