# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: a region of 24 bits between two DMA engines of 32; it inverts every byte."""

from __future__ import annotations

import os
import random

import cocotb
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import AxiStreamFrame
from stream_board import StreamBoard

KEEP = os.environ["CM_KEEP"] == "1"
DECOUPLE, STATUS = 0x4000_0100, 0x4000_0108


class Board(StreamBoard):
    def __init__(self, dut: object) -> None:
        super().__init__(dut, "axis_prr0_s_axis", "axis_prr0_m_axis", seed=5)

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
