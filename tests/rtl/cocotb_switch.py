# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: a switch between two regions (32 and 24 bits) and memory; each adds its number to a byte.

Registers are written as PG085 ("Usage") and Xilinx' driver (axis_switch of embeddedsw) write them.
"""

from __future__ import annotations

import random

import cocotb
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import AxiStreamFrame
from stream_board import StreamBoard

SWITCH, DECOUPLE = 0x4000_1000, 0x4000_0100
NONE = 0x8000_0000
TO_CHAIN, LEFT_OUT, RIGHT_OUT = range(3)  # sources
FROM_CHAIN, LEFT_IN, RIGHT_IN = range(3)  # sinks
CHAIN = {LEFT_IN: TO_CHAIN, RIGHT_IN: LEFT_OUT, FROM_CHAIN: RIGHT_OUT}
ADDED = {"left": 1, "right": 3}


class Board(StreamBoard):
    def __init__(self, dut: object) -> None:
        super().__init__(dut, "axis_to_chain", "axis_from_chain", seed=3)

    async def write(self, address: int, value: int) -> None:
        await self.registers.write(address, value.to_bytes(4, "little"))

    async def read(self, address: int) -> int:
        return int.from_bytes((await self.registers.read(address, 4)).data, "little")

    async def route(self, routes: dict[int, int]) -> None:
        for sink in range(3):
            await self.write(SWITCH + 0x40 + 4 * sink, routes.get(sink, NONE))
        await self.write(SWITCH, 2)
        while await self.read(SWITCH) & 2:
            pass

    async def receive(self) -> bytes:
        frame = await with_timeout(self.sink.recv(compact=False), 300, "us")
        kept = frame.tkeep or [1] * len(frame.tdata)
        return bytes(byte for byte, keep in zip(frame.tdata, kept, strict=True) if keep)

    async def through(self, data: bytes) -> bytes:
        await self.source.send(AxiStreamFrame(data))
        return await self.receive()


def added(data: bytes, *regions: str) -> bytes:
    return bytes((byte + sum(ADDED[region] for region in regions)) % 256 for byte in data)


def frame(number: int, size: int = 48) -> bytes:
    return random.Random(number).randbytes(size)


@cocotb.test()
async def frames_pass_through_a_chain_of_two_regions_to_the_byte(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await board.route(CHAIN)
    for number, size in enumerate((12, 24, 48, 60, 120)):
        assert await board.through(frame(number, size)) == added(frame(number, size), "left", "right")
    assert not board.out.errors, board.out.errors[:3]


@cocotb.test()
async def each_set_of_routes_is_another_chain(dut: object) -> None:
    board = Board(dut)
    await board.start()
    chains = [
        (CHAIN, ("left", "right")),
        ({RIGHT_IN: TO_CHAIN, LEFT_IN: RIGHT_OUT, FROM_CHAIN: LEFT_OUT}, ("right", "left")),
        ({LEFT_IN: TO_CHAIN, FROM_CHAIN: LEFT_OUT}, ("left",)),
        ({RIGHT_IN: TO_CHAIN, FROM_CHAIN: RIGHT_OUT}, ("right",)),
        ({FROM_CHAIN: TO_CHAIN}, ()),
    ]
    for number, (routes, regions) in enumerate(chains * 2):
        await board.route(routes)
        for index in range(3):
            data = frame(10 * number + index)
            assert await board.through(data) == added(data, *regions)
    assert not board.out.errors, board.out.errors[:3]


@cocotb.test()
async def after_reset_no_sink_has_a_source_and_nothing_is_lost(dut: object) -> None:
    board = Board(dut)
    await board.start()
    for sink in range(3):
        assert await board.read(SWITCH + 0x40 + 4 * sink) == NONE
    await board.source.send(AxiStreamFrame(frame(1)))
    await ClockCycles(board.clk, 200)
    assert board.sink.empty()
    await board.route({FROM_CHAIN: TO_CHAIN})
    assert await board.receive() == frame(1)


@cocotb.test()
async def written_routes_count_only_when_they_are_committed(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await board.route({FROM_CHAIN: TO_CHAIN})
    await board.write(SWITCH + 0x40, RIGHT_OUT)
    assert await board.read(SWITCH + 0x40) == RIGHT_OUT
    assert await board.through(frame(2)) == frame(2)


@cocotb.test()
async def a_source_of_two_sinks_goes_to_the_lower_one(dut: object) -> None:
    """PG085, MI_MUX: the lower master interface wins control, the higher one is disabled."""
    board = Board(dut)
    await board.start()
    await board.route({FROM_CHAIN: TO_CHAIN, LEFT_IN: TO_CHAIN})
    assert await board.through(frame(3)) == frame(3)


@cocotb.test()
async def routes_that_change_in_a_packet_end_it_and_begin_with_a_whole_one(dut: object) -> None:
    board = Board(dut)
    await board.start()
    for number in range(12):
        await board.route(CHAIN)
        await board.source.send(AxiStreamFrame(frame(100 + number, 480)))
        await ClockCycles(board.clk, 40 + 7 * number)
        await board.route({FROM_CHAIN: TO_CHAIN})
        await ClockCycles(board.clk, 400)
        while not board.sink.empty():
            board.sink.recv_nowait()
        await board.source.wait()
        assert await board.through(frame(number)) == frame(number)
        # what the regions still held of the packet before is not for the next chain either
        for region in range(2):
            await board.write(DECOUPLE + 0x10 * region, 1)
        await ClockCycles(board.clk, 60)
        for region in range(2):
            await board.write(DECOUPLE + 0x10 * region, 0)
        await ClockCycles(board.clk, 60)
    assert not board.out.errors, board.out.errors[:3]
