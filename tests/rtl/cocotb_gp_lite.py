# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the bridge between an AXI master and a memory on AXI4-Lite, both of cocotbext-axi."""

from __future__ import annotations

import random

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import AxiBus, AxiLiteBus, AxiLiteRam, AxiMaster, AxiResp
from protocol import quiet


async def begin(dut: object, seed: int) -> tuple[AxiMaster, AxiLiteRam]:
    quiet()
    cocotb.start_soon(Clock(dut.clk, 10, "ns").start())
    dut.resetn.value = 0
    ends = {"clock": dut.clk, "reset": dut.resetn, "reset_active_level": False}
    master = AxiMaster(AxiBus.from_prefix(dut, "s"), **ends, max_burst_len=16)
    memory = AxiLiteRam(AxiLiteBus.from_prefix(dut, "m"), **ends, size=4096)
    chance = random.Random(seed)
    channels = [
        *(getattr(master.write_if, name) for name in ("aw_channel", "w_channel", "b_channel")),
        *(getattr(master.read_if, name) for name in ("ar_channel", "r_channel")),
        *(getattr(memory.write_if, name) for name in ("aw_channel", "w_channel", "b_channel")),
        *(getattr(memory.read_if, name) for name in ("ar_channel", "r_channel")),
    ]
    for channel in channels:
        channel.set_pause_generator(iter(lambda: chance.random() < 0.4, None))
    await ClockCycles(dut.clk, 5)
    dut.resetn.value = 1
    await ClockCycles(dut.clk, 5)
    return master, memory


@cocotb.test()
async def words_and_bursts_reach_their_addresses_and_come_back(dut: object) -> None:
    master, memory = await begin(dut, 1)
    chance = random.Random(2)
    expected = bytearray(4096)
    memory.write(0, bytes(4096))
    for _ in range(60):
        length = chance.choice((1, 2, 4, 4, 8, 64, 150))
        address = chance.randrange(0, 4096 - length)
        data = chance.randbytes(length)
        written = await with_timeout(master.write(address, data), 100, "us")
        assert written.resp == AxiResp.OKAY
        expected[address : address + length] = data
        start = chance.randrange(0, 4000)
        read = await with_timeout(master.read(start, 96), 100, "us")
        assert read.data == expected[start : start + 96]
    assert memory.read(0, 4096) == expected


@cocotb.test()
async def reads_and_writes_at_once_do_not_disturb_each_other(dut: object) -> None:
    master, memory = await begin(dut, 3)
    memory.write(2048, bytes(range(256)))
    reads = [cocotb.start_soon(master.read(2048 + 64 * (number % 4), 64)) for number in range(8)]
    writes = [cocotb.start_soon(master.write(64 * number, bytes([number + 1]) * 64)) for number in range(8)]
    for number, task in enumerate(reads):
        found = await with_timeout(task, 200, "us")
        assert found.data == bytes(range(64 * (number % 4), 64 * (number % 4) + 64))
    for task in writes:
        await with_timeout(task, 200, "us")
    assert memory.read(0, 512) == b"".join(bytes([number + 1]) * 64 for number in range(8))
