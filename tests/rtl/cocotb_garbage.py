# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the static part with a region that drives garbage, as while it is being loaded."""

from __future__ import annotations

import cocotb
from cocotb.triggers import ClockCycles
from cocotb_static_part import DECOUPLE, STATUS, WINDOW, Board
from cocotbext.axi import AxiResp


@cocotb.test()
async def garbage_reaches_the_dma_without_decoupling(dut: object) -> None:
    """The negative test: were nothing to arrive here, the next one would show nothing."""
    board = Board(dut)
    await board.start()
    await ClockCycles(dut.clk_fclk0, 300)
    assert board.out.beats > 10


@cocotb.test()
async def a_decoupled_region_is_not_heard(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await board.write(DECOUPLE, 1)
    await board.wait_for(STATUS, 1, 1)
    await ClockCycles(dut.clk_fclk0, 20)
    beats = board.out.beats
    for _ in range(20):
        assert (await board.read(WINDOW))[1] == AxiResp.SLVERR
        assert await board.write(WINDOW, 1) == AxiResp.SLVERR
        await ClockCycles(dut.clk_fclk0, 50)
        assert dut.irq.value == 0
    assert board.out.beats == beats
    board.check()


@cocotb.test()
async def even_coupled_garbage_never_breaks_the_protocol_on_the_static_side(dut: object) -> None:
    board = Board(dut)
    await board.start()
    for _ in range(30):
        await board.read(WINDOW)
        await board.write(WINDOW, 1)
    board.check()
