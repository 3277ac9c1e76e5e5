# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: a region with 70 interrupts, of which a beat's value raises one for a clock."""

from __future__ import annotations

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiStreamBus, AxiStreamFrame, AxiStreamSource
from protocol import quiet

CONTROL, LINES = 0x4000_0000, 70
BANKS = (0x008, 0x020, 0x030)  # status; enable and raw behind it


@cocotb.test()
async def every_line_is_told_enabled_and_cleared_in_its_bank(dut: object) -> None:
    quiet()
    clk, reset = dut.clk_fclk0, dut.resetn_fclk0
    cocotb.start_soon(Clock(clk, 10, "ns").start())
    reset.value = 0
    dut.axis_icap_tvalid.value = 0
    dut.axis_prr0_m_axis_tready.value = 1
    ends = {"clock": clk, "reset": reset, "reset_active_level": False}
    bus = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi_fclk0"), **ends)
    source = AxiStreamSource(AxiStreamBus.from_prefix(dut, "axis_prr0_s_axis"), **ends)

    async def write(offset: int, value: int) -> None:
        await bus.write(CONTROL + offset, value.to_bytes(4, "little"))

    async def read(offset: int) -> int:
        return int.from_bytes((await bus.read(CONTROL + offset, 4)).data, "little")

    await ClockCycles(clk, 5)
    reset.value = 1
    await ClockCycles(clk, 40)
    assert (await read(4)) >> 8 & 0xFF == LINES
    for line in (0, 1, 31, 32, 33, 63, 64, LINES - 1):
        await source.send(AxiStreamFrame(line.to_bytes(4, "little")))
        await ClockCycles(clk, 12)
        bank, bit = divmod(line, 32)
        assert [await read(at) for at in BANKS] == [1 << bit if bank == other else 0 for other in range(3)]
        assert not dut.irq.value
        await write(BANKS[bank] + 4, 1 << bit)
        assert await read(BANKS[bank] + 4) == 1 << bit
        await ClockCycles(clk, 3)
        assert dut.irq.value
        await write(BANKS[bank], 1 << bit)
        await ClockCycles(clk, 3)
        assert not dut.irq.value
        assert await read(BANKS[bank]) == 0
        await write(BANKS[bank] + 4, 0)
