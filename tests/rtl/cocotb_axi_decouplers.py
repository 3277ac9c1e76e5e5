# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the AXI4 decouplers under random traffic while `decouple` comes and goes."""

from __future__ import annotations

import itertools
import random

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, RisingEdge, with_timeout
from cocotbext.axi import AxiBus, AxiMaster, AxiRam, AxiResp
from protocol import AxiChecker, quiet

SIZE = 1 << 12


class Bench:
    """Clock, reset, a master and a memory on the two sides, and a checker on the static side."""

    def __init__(self, dut: object, static: str) -> None:
        quiet()
        self.dut = dut
        cocotb.start_soon(Clock(dut.clk, 10, "ns").start())
        dut.decouple.value = 0
        if hasattr(dut, "clear"):
            dut.clear.value = 0
        dut.resetn.value = 0
        dut.region_resetn.value = 0
        # the region is the slave behind s_axi's decoupler, or the master before m_axi's
        ours, theirs = (dut.resetn, dut.region_resetn) if static == "s_axi" else (dut.region_resetn, dut.resetn)
        self.master = AxiMaster(AxiBus.from_prefix(dut, "s_axi"), dut.clk, ours, reset_active_level=False)
        self.ram = AxiRam(AxiBus.from_prefix(dut, "m_axi"), dut.clk, theirs, reset_active_level=False, size=SIZE)
        self.checker = AxiChecker(dut, dut.clk, dut.resetn, static)

    async def start(self) -> None:
        await ClockCycles(self.dut.clk, 5)
        self.dut.resetn.value = 1
        self.dut.region_resetn.value = 1
        await ClockCycles(self.dut.clk, 5)

    async def exchange(self) -> None:
        """What a load does: decouple, a new region from reset, recouple."""
        self.dut.decouple.value = 1
        while True:
            await RisingEdge(self.dut.clk)
            if self.dut.decoupled.value == 1:
                break
        self.dut.region_resetn.value = 0
        if hasattr(self.dut, "clear"):
            self.dut.clear.value = 1
        await ClockCycles(self.dut.clk, 4)
        self.dut.region_resetn.value = 1
        if hasattr(self.dut, "clear"):
            self.dut.clear.value = 0
        await ClockCycles(self.dut.clk, 2)
        self.dut.decouple.value = 0

    def pauses(self, seed: int) -> None:
        """Every channel stalls at random."""
        chance = random.Random(seed)
        channels = [
            self.master.write_if.aw_channel,
            self.master.write_if.w_channel,
            self.master.write_if.b_channel,
            self.master.read_if.ar_channel,
            self.master.read_if.r_channel,
            self.ram.write_if.aw_channel,
            self.ram.write_if.w_channel,
            self.ram.write_if.b_channel,
            self.ram.read_if.ar_channel,
            self.ram.read_if.r_channel,
        ]
        for channel in channels:
            channel.set_pause_generator(iter(lambda: chance.random() < 0.3, None))

    async def read(self, address: int, length: int) -> tuple[bytes, AxiResp]:
        found = await with_timeout(self.master.read(address, length), 200, "us")
        return bytes(found.data), found.resp

    async def write(self, address: int, data: bytes) -> AxiResp:
        return (await with_timeout(self.master.write(address, data), 200, "us")).resp


@cocotb.test()
async def slave_passes_bursts_unchanged(dut: object) -> None:
    bench = Bench(dut, "s_axi")
    await bench.start()
    bench.pauses(1)
    chance = random.Random(2)
    for _ in range(40):
        address, length = chance.randrange(SIZE - 512), chance.randrange(1, 512)
        data = chance.randbytes(length)
        assert await bench.write(address, data) == AxiResp.OKAY
        assert await bench.read(address, length) == (data, AxiResp.OKAY)
    assert dut.stuck.value == 0
    bench.checker.check()


@cocotb.test()
async def slave_answers_every_access_while_decoupled(dut: object) -> None:
    bench = Bench(dut, "s_axi")
    await bench.start()
    assert await bench.write(0, b"before--") == AxiResp.OKAY
    dut.decouple.value = 1
    await ClockCycles(dut.clk, 3)
    assert dut.decoupled.value == 1
    for length in (4, 64, 300):
        assert await bench.write(0, bytes(length)) == AxiResp.SLVERR
        assert (await bench.read(0, length))[1] == AxiResp.SLVERR
    assert bench.ram.read(0, 8) == b"before--"
    dut.decouple.value = 0
    assert await bench.read(0, 8) == (b"before--", AxiResp.OKAY)
    bench.checker.check()


@cocotb.test()
async def slave_survives_decoupling_at_any_moment(dut: object) -> None:
    bench = Bench(dut, "s_axi")
    await bench.start()
    bench.pauses(3)
    chance = random.Random(4)

    async def toggle() -> None:
        while True:
            await ClockCycles(dut.clk, chance.randrange(5, 400))
            await bench.exchange()

    task = cocotb.start_soon(toggle())
    answers = set()
    for _ in range(60):
        address, length = chance.randrange(SIZE - 256), chance.randrange(1, 256)
        answers.add(await bench.write(address, chance.randbytes(length)))
        answers.add((await bench.read(address, length))[1])
    task.cancel()
    assert answers == {AxiResp.OKAY, AxiResp.SLVERR}
    bench.checker.check()


@cocotb.test()
async def slave_gives_up_on_a_region_that_does_not_answer(dut: object) -> None:
    bench = Bench(dut, "s_axi")
    await bench.start()
    bench.ram.read_if.ar_channel.set_pause_generator(itertools.repeat(True))
    assert (await bench.read(0, 16))[1] == AxiResp.SLVERR
    assert dut.stuck.value == 1
    assert await bench.write(0, b"1234") == AxiResp.SLVERR  # the whole region is cut off
    bench.ram.read_if.ar_channel.clear_pause_generator()
    dut.clear.value = 1
    await ClockCycles(dut.clk, 3)
    dut.clear.value = 0
    await ClockCycles(dut.clk, 3)
    assert await bench.write(0, b"1234") == AxiResp.OKAY
    bench.checker.check()


@cocotb.test()
async def master_passes_bursts_unchanged(dut: object) -> None:
    bench = Bench(dut, "m_axi")
    await bench.start()
    bench.pauses(5)
    chance = random.Random(6)
    for _ in range(40):
        address, length = chance.randrange(SIZE - 512), chance.randrange(1, 512)
        data = chance.randbytes(length)
        assert await bench.write(address, data) == AxiResp.OKAY
        assert await bench.read(address, length) == (data, AxiResp.OKAY)
    bench.checker.check()


@cocotb.test()
async def master_ends_what_the_region_began(dut: object) -> None:
    """Decoupled in the midst of bursts: the interconnect gets every beat, and memory is not written any more."""
    bench = Bench(dut, "m_axi")
    await bench.start()
    bench.pauses(7)
    chance = random.Random(8)
    for round_ in range(25):
        bench.ram.write(0, bytes(SIZE))
        # a reset flushes what the master had under way, so these end
        cocotb.start_soon(bench.master.write(0, b"\xff" * 1024))
        cocotb.start_soon(bench.master.read(2048, 1024))
        await ClockCycles(dut.clk, chance.randrange(3, 600))
        before = bytes(bench.ram.read(0, 1024))
        await with_timeout(bench.exchange(), 100, "us")
        after = bytes(bench.ram.read(0, 1024))
        # at most the beat that was on its way reached memory
        assert 0 <= after.count(0xFF) - before.count(0xFF) <= 8, f"round {round_}"
        await ClockCycles(dut.clk, 50)
        assert bytes(bench.ram.read(0, 1024)) == after, f"round {round_}: written by a region that is gone"
    assert await bench.write(16, b"anew") == AxiResp.OKAY
    bench.checker.check()
