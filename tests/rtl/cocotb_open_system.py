# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the open flow's whole static part, driven by the processing system's ports alone.

Pictures lie in the memory behind HP0, the processor programs the DMA engine through GP0, interrupts come on IRQF2P.
"""

from __future__ import annotations

import os
import random

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, RisingEdge, with_timeout
from cocotbext.axi import AxiBus, AxiMaster, AxiRam, AxiResp
from protocol import quiet

from cm.simulation.software.hardware import models

LINE, LINES = 16, 12
CONTROL, WINDOW, DMA = 0x4000_0000, 0x4001_0000, 0x4400_0000
MM2S, S2MM = DMA, DMA + 0x30
CR, SR, ADDRESS, LENGTH = 0x00, 0x04, 0x18, 0x28
FROM, TO = 0x1FC0, 0x8F38  # buffers, across 4 KiB


class Processor:
    """What a driver has of the board."""

    def __init__(self, dut: object) -> None:
        quiet()
        self.ps7 = dut.system.ps7
        self.clock = self.ps7.clk
        cocotb.start_soon(Clock(self.clock, 20, "ns").start())
        self.ps7.resetn.value = 0
        ends = {"clock": self.clock, "reset": self.ps7.resetn, "reset_active_level": False}
        self._master = AxiMaster(AxiBus.from_prefix(self.ps7, "gp"), **ends, max_burst_len=16)
        self.memory = AxiRam(AxiBus.from_prefix(self.ps7, "hp"), **ends, size=1 << 16)
        chance = random.Random(1)
        for channel in (self.memory.read_if.r_channel, self.memory.write_if.w_channel, self.memory.write_if.aw_channel):
            channel.set_pause_generator(iter(lambda: chance.random() < 0.3, None))

    async def begin(self) -> None:
        await ClockCycles(self.clock, 10)
        self.ps7.resetn.value = 1
        await ClockCycles(self.clock, 40)

    async def read(self, address: int) -> int:
        found = await with_timeout(self._master.read(address, 4), 100, "us")
        assert found.resp == AxiResp.OKAY
        return int.from_bytes(found.data, "little")

    async def write(self, address: int, value: int) -> None:
        done = await with_timeout(self._master.write(address, value.to_bytes(4, "little")), 100, "us")
        assert done.resp == AxiResp.OKAY

    async def wrong(self, address: int) -> AxiResp:
        return (await with_timeout(self._master.read(address, 4), 100, "us")).resp

    async def interrupt(self, line: int) -> None:
        for _ in range(100_000):
            await RisingEdge(self.clock)
            if int(self.ps7.IRQF2P.value) >> line & 1:
                return
        raise AssertionError(f"line {line} stays low")

    async def through(self, picture: np.ndarray) -> np.ndarray:
        """From memory to the region and back."""
        self.memory.write(FROM, picture.tobytes())
        await self.write(S2MM + ADDRESS, TO)
        await self.write(S2MM + LENGTH, picture.size)
        await self.write(MM2S + ADDRESS, FROM)
        await self.write(MM2S + LENGTH, picture.size)
        for line, channel in ((1, MM2S), (2, S2MM)):
            await self.interrupt(line)
            await self.write(channel + SR, 1 << 12)
        assert await self.read(S2MM + LENGTH) == picture.size
        return np.frombuffer(self.memory.read(TO, picture.size), np.uint8).reshape(picture.shape)


@cocotb.test()
async def pictures_pass_from_memory_through_the_region_and_back(dut: object) -> None:
    board = Processor(dut)
    await board.begin()
    assert await board.read(CONTROL) == 0x434D3031
    assert await board.read(CONTROL + 0x10C) == int(os.environ["CM_IDENTITY"])
    assert await board.wrong(DMA + 0x10000) == AxiResp.DECERR
    for channel in (MM2S, S2MM):
        await board.write(channel + CR, 0x1001)
        assert await board.read(channel + SR) & 1 == 0
    await board.write(CONTROL + 0x0C, 1)  # the module's own interrupt, line 0
    random = np.random.default_rng(2)
    for number in range(3):
        picture = random.integers(0, 256, (LINES, LINE), np.uint8)
        await board.write(WINDOW + 0x18, 40 * number)
        came = await board.through(picture)
        assert np.array_equal(came, models.edge(picture, {"threshold": 40 * number}))
        await board.interrupt(0)
        await board.write(CONTROL + 0x08, 1)
    assert await board.read(WINDOW + 0x04) == 3


@cocotb.test()
async def a_region_that_is_cut_off_keeps_its_picture_waiting(dut: object) -> None:
    board = Processor(dut)
    await board.begin()
    await board.write(CONTROL + 0x100, 1)
    for channel in (MM2S, S2MM):
        await board.write(channel + CR, 0x1001)
    picture = np.arange(LINE * LINES, dtype=np.uint8).reshape(LINES, LINE)
    waiting = cocotb.start_soon(board.through(picture))
    await ClockCycles(board.clock, 2000)
    assert int(board.ps7.IRQF2P.value) == 0
    await board.write(CONTROL + 0x100, 0)
    assert np.array_equal(await waiting, models.edge(picture, {"threshold": 0}))
