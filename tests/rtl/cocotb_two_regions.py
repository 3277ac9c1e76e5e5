# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the generated static part of the two-region example, on its two clocks."""

from __future__ import annotations

import os

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, with_timeout
from cocotbext.axi import (
    AxiLiteBus,
    AxiLiteMaster,
    AxiResp,
    AxiStreamBus,
    AxiStreamFrame,
    AxiStreamSink,
    AxiStreamSource,
)
from protocol import AxiChecker, Handshake, quiet

CONTROL, FILTER, CORRECTION = 0xA000_0000, 0xA001_0000, 0xA100_0000
IRQ_STATUS, IRQ_ENABLE = CONTROL + 0x08, CONTROL + 0x0C
FIRST, SECOND = CONTROL + 0x100, CONTROL + 0x110
DECOUPLE, STATUS, IDENTITY = 0x0, 0x8, 0xC
SECOND_MODULE = os.environ.get("CM_SECOND", "gain")


class Board:
    """Two clocks that have nothing to do with each other."""

    def __init__(self, dut: object) -> None:
        quiet()
        self.dut = dut
        slow, fast = dut.clk_pl_clk0, dut.clk_pl_clk1
        cocotb.start_soon(Clock(slow, 10_000, "ps").start())
        cocotb.start_soon(Clock(fast, 6_666, "ps").start())
        self.resets = (dut.resetn_pl_clk0, dut.resetn_pl_clk1)
        for reset in self.resets:
            reset.value = 0
        dut.axis_icap_tvalid.value = 0
        self.slow = self._master("s_axi_pl_clk0", slow, self.resets[0])
        self.fast = self._master("s_axi_pl_clk1", fast, self.resets[1])
        self.checkers = [
            AxiChecker(dut, slow, self.resets[0], "s_axi_pl_clk0"),
            AxiChecker(dut, fast, self.resets[1], "s_axi_pl_clk1"),
        ]
        self.outs = []
        self.ends = {}
        for name, clock, reset in (("filter", slow, self.resets[0]), ("correction", fast, self.resets[1])):
            bus_in, bus_out = f"axis_to_{name}", f"axis_from_{name}"
            source = AxiStreamSource(
                AxiStreamBus.from_prefix(dut, bus_in), clock, reset, reset_active_level=False, byte_lanes=4
            )
            sink = AxiStreamSink(
                AxiStreamBus.from_prefix(dut, bus_out), clock, reset, reset_active_level=False, byte_lanes=4
            )
            self.ends[name] = (source, sink)
            payload = [f"{bus_out}_tdata", f"{bus_out}_tlast"]
            self.outs.append(Handshake(dut, clock, reset, bus_out, f"{bus_out}_tvalid", f"{bus_out}_tready", payload))

    def _master(self, prefix: str, clock: object, reset: object) -> AxiLiteMaster:
        return AxiLiteMaster(AxiLiteBus.from_prefix(self.dut, prefix), clock, reset, reset_active_level=False)

    async def start(self) -> None:
        await ClockCycles(self.dut.clk_pl_clk0, 5)
        for reset in self.resets:
            reset.value = 1
        await ClockCycles(self.dut.clk_pl_clk0, 60)

    async def through(self, name: str, data: bytes) -> bytes:
        source, sink = self.ends[name]
        await source.send(AxiStreamFrame(data))
        frame = await with_timeout(sink.recv(), 100, "us")
        return bytes(frame.tdata)

    def check(self) -> None:
        for checker in self.checkers:
            checker.check()
        errors = [error for out in self.outs for error in out.errors]
        assert not errors, "\n".join(errors[:10])


async def read(master: AxiLiteMaster, address: int) -> tuple[int, AxiResp]:
    found = await with_timeout(master.read(address, 4), 100, "us")
    return int.from_bytes(bytes(found.data), "little"), found.resp


async def write(master: AxiLiteMaster, address: int, value: int) -> AxiResp:
    return (await with_timeout(master.write(address, value.to_bytes(4, "little")), 100, "us")).resp


async def wait_for(master: AxiLiteMaster, address: int, want: int) -> None:
    for _ in range(500):
        if (await read(master, address))[0] == want:
            return
    raise AssertionError(f"{address:#x} never read {want:#x}")


@cocotb.test()
async def both_regions_say_what_they_hold(dut: object) -> None:
    board = Board(dut)
    await board.start()
    assert (await read(board.slow, CONTROL + 4))[0] == 0x0102
    assert (await read(board.slow, FIRST + IDENTITY))[0] == int(os.environ["CM_FIRST_ID"])
    assert (await read(board.slow, SECOND + IDENTITY))[0] == int(os.environ["CM_SECOND_ID"])
    board.check()


@cocotb.test()
async def cutting_one_region_leaves_the_other_working(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await write(board.slow, SECOND + DECOUPLE, 1)
    await wait_for(board.slow, SECOND + STATUS, 1)
    assert (await read(board.fast, CORRECTION))[1] == AxiResp.SLVERR
    assert (await read(board.slow, SECOND + IDENTITY))[0] == 0
    assert (await read(board.slow, FILTER))[0].to_bytes(4, "big") == b"EDGE"
    assert len(await board.through("filter", bytes(64))) == 64
    await write(board.slow, SECOND + DECOUPLE, 0)
    await wait_for(board.slow, SECOND + STATUS, 0)
    await ClockCycles(dut.clk_pl_clk0, 60)
    assert (await read(board.slow, SECOND + IDENTITY))[0] == int(os.environ["CM_SECOND_ID"])
    board.check()


@cocotb.test(skip=SECOND_MODULE != "gain")
async def a_register_on_the_second_clock_acts_on_the_stream(dut: object) -> None:
    board = Board(dut)
    await board.start()
    assert await write(board.fast, CORRECTION, 32) == AxiResp.OKAY
    assert await read(board.fast, CORRECTION) == (32, AxiResp.OKAY)
    assert await board.through("correction", bytes([10, 100, 200, 0] * 8)) == bytes([20, 200, 255, 0] * 8)
    board.check()


@cocotb.test(skip=SECOND_MODULE != "invert")
async def a_module_without_registers_answers_with_an_error_and_stays_in_use(dut: object) -> None:
    board = Board(dut)
    await board.start()
    for _ in range(3):
        assert (await read(board.fast, CORRECTION))[1] == AxiResp.SLVERR
        assert await write(board.fast, CORRECTION, 1) == AxiResp.SLVERR
    assert (await read(board.slow, SECOND + STATUS))[0] == 0  # not stuck: it did answer
    assert await board.through("correction", bytes([10, 100, 200, 0] * 8)) == bytes([245, 155, 55, 0] * 8)
    board.check()


@cocotb.test()
async def an_interrupt_of_the_filter_reaches_the_processor(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await write(board.slow, IRQ_ENABLE, 1)
    await board.through("filter", bytes(64))
    await ClockCycles(dut.clk_pl_clk0, 10)
    assert dut.irq.value == 1
    await write(board.slow, IRQ_STATUS, 1)
    assert dut.irq.value == 0
    board.check()
