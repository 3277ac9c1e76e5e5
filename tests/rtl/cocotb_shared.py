# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: three regions on one MCDMA (32, 8 and 24 bits); each adds its number to every byte."""

from __future__ import annotations

import random

import cocotb
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import AxiStreamFrame
from stream_board import StreamBoard

ADDED = (1, 2, 3)
SIZES = (4, 1, 3)  # bytes of a beat of each region
DECOUPLE = 0x4000_0100


class Board(StreamBoard):
    def __init__(self, dut: object) -> None:
        super().__init__(dut, "axis_all_mm2s", "axis_all_s2mm", seed=7, payload=("tdest",))

    async def receive(self) -> tuple[int, bytes]:
        frame = await with_timeout(self.sink.recv(compact=False), 2000, "us")
        numbers = {frame.tdest} if isinstance(frame.tdest, int) else set(frame.tdest)
        assert len(numbers) == 1, "a packet of several channels"
        kept = frame.tkeep or [1] * len(frame.tdata)
        return numbers.pop(), bytes(byte for byte, keep in zip(frame.tdata, kept, strict=True) if keep)


def changed(channel: int, data: bytes) -> bytes:
    return bytes((byte + ADDED[channel]) % 256 for byte in data)


@cocotb.test()
async def packets_of_all_channels_come_back_on_theirs_in_order(dut: object) -> None:
    board = Board(dut)
    await board.start()
    chance = random.Random(11)
    sent: dict[int, list[bytes]] = {0: [], 1: [], 2: []}
    for _ in range(60):
        channel = chance.randrange(3)
        data = chance.randbytes(SIZES[channel] * chance.randrange(1, 30))
        sent[channel].append(data)
        await board.source.send(AxiStreamFrame(data, tdest=channel))
    got: dict[int, list[bytes]] = {0: [], 1: [], 2: []}
    for _ in range(60):
        channel, data = await board.receive()
        got[channel].append(data)
    assert got == {channel: [changed(channel, data) for data in packets] for channel, packets in sent.items()}
    assert not board.out.errors, board.out.errors[:3]


@cocotb.test()
async def packets_for_a_channel_that_there_is_not_stop_nobody(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await board.source.send(AxiStreamFrame(bytes(100), tdest=9))
    await board.source.send(AxiStreamFrame(b"abcdef", tdest=2))
    assert await board.receive() == (2, changed(2, b"abcdef"))


@cocotb.test()
async def a_region_that_is_cut_off_in_a_packet_ends_it_and_the_others_go_on(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await board.source.send(AxiStreamFrame(bytes(400), tdest=1))
    await ClockCycles(board.clk, 60)
    await board.registers.write(DECOUPLE + 0x10, bytes((1, 0, 0, 0)))
    channel, data = await board.receive()
    assert channel == 1
    assert len(data) < 400
    await board.source.send(AxiStreamFrame(bytes(range(8)), tdest=0))
    assert await board.receive() == (0, changed(0, bytes(range(8))))
    assert not board.out.errors, board.out.errors[:3]
