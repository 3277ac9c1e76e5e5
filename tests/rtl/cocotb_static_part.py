# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the generated static part of the camera example with a module's wrapper in its region."""

from __future__ import annotations

import os
import random
import re
from pathlib import Path

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, RisingEdge, with_timeout
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

from cm.simulation.software.hardware import models

LINE, LINES = 16, 12
CONTROL, WINDOW = 0x4000_0000, 0x4001_0000
IRQ_STATUS, IRQ_ENABLE = CONTROL + 0x08, CONTROL + 0x0C
STATIC_ID = CONTROL + 0x1C
DECOUPLE, RESET, STATUS, IDENTITY = (CONTROL + 0x100 + offset for offset in (0, 4, 8, 12))
MODULE = os.environ.get("CM_MODULE", "edge")


class Board:
    """The processor's side of the static part."""

    def __init__(self, dut: object) -> None:
        quiet()
        self.dut, self.clk, self.reset = dut, dut.clk_fclk0, dut.resetn_fclk0
        cocotb.start_soon(Clock(self.clk, 10, "ns").start())
        self.reset.value = 0
        dut.axis_icap_tvalid.value = 0
        bus = AxiLiteBus.from_prefix(dut, "s_axi_fclk0")
        self.registers = AxiLiteMaster(bus, self.clk, self.reset, reset_active_level=False)
        sensor = AxiStreamBus.from_prefix(dut, "axis_prr0_s_axis")
        self.source = AxiStreamSource(sensor, self.clk, self.reset, reset_active_level=False, byte_lanes=1)
        from_pl = AxiStreamBus.from_prefix(dut, "axis_camera")
        self.sink = AxiStreamSink(from_pl, self.clk, self.reset, reset_active_level=False, byte_lanes=1)
        self.lite = AxiChecker(dut, self.clk, self.reset, "s_axi_fclk0")
        prefix = "axis_camera"
        payload = [f"{prefix}_tdata", f"{prefix}_tlast"]
        self.out = Handshake(dut, self.clk, self.reset, prefix, f"{prefix}_tvalid", f"{prefix}_tready", payload)

    async def start(self) -> None:
        await ClockCycles(self.clk, 5)
        self.reset.value = 1
        await ClockCycles(self.clk, 40)

    async def read(self, address: int) -> tuple[int, AxiResp]:
        found = await with_timeout(self.registers.read(address, 4), 900, "us")
        return int.from_bytes(bytes(found.data), "little"), found.resp

    async def write(self, address: int, value: int) -> AxiResp:
        return (await with_timeout(self.registers.write(address, value.to_bytes(4, "little")), 900, "us")).resp

    async def wait_for(self, address: int, mask: int, want: int) -> None:
        for _ in range(2000):
            if (await self.read(address))[0] & mask == want:
                return
        raise AssertionError(f"{address:#x} never read {want:#x}")

    def stall(self, seed: int) -> None:
        chance = random.Random(seed)
        for end in (self.source, self.sink):
            end.set_pause_generator(iter(lambda: chance.random() < 0.3, None))

    def check(self) -> None:
        self.lite.check()
        assert not self.out.errors, "\n".join(self.out.errors[:10])


def picture(seed: int) -> np.ndarray:
    pixels = np.random.default_rng(seed).integers(0, 256, (LINES, LINE), dtype=np.uint8)
    pixels[3:8, 4:10] //= 8  # something with edges
    return pixels


# What each module is to give is what the simulated board's model of it gives: registers, and their offsets.
EXPECTED = {
    "edge": ({0x18: 90}, lambda pixels: models.edge(pixels, {"threshold": 90})),
    "default": ({0x10: 7, 0x14: 2}, lambda pixels: pixels),
    "colorise": ({0x1C: 2}, lambda pixels: models.Colorise()(pixels, {"palette": 2})),
}


def check_frame(frame: AxiStreamFrame, want: np.ndarray) -> None:
    np.testing.assert_array_equal(np.frombuffer(bytes(frame.tdata), np.uint8).reshape(want.shape), want)


IDS = {"edge": b"EDGE", "default": b"DEFA", "colorise": b"COLO"}


@cocotb.test()
async def frames_pass_bit_exact(dut: object) -> None:
    board = Board(dut)
    await board.start()
    board.stall(1)
    registers, model = EXPECTED[MODULE]
    for offset, value in registers.items():
        assert await board.write(WINDOW + offset, value) == AxiResp.OKAY
        assert await board.read(WINDOW + offset) == (value, AxiResp.OKAY)
    for seed in range(3):
        await board.source.send(AxiStreamFrame(picture(seed).tobytes()))
    for seed in range(3):
        frame = await with_timeout(board.sink.recv(), 200, "us")
        check_frame(frame, model(picture(seed)))
    assert await board.read(WINDOW + 4) == (3, AxiResp.OKAY)
    board.check()


@cocotb.test()
async def addresses_outside_every_window_are_refused(dut: object) -> None:
    board = Board(dut)
    await board.start()
    for address in (CONTROL + 0x1000, WINDOW + 0x10000, 0x4100_0000, 0):
        assert (await board.read(address))[1] == AxiResp.DECERR
        assert await board.write(address, 1) == AxiResp.DECERR
    assert (await board.read(CONTROL))[0] == 0x434D3031
    assert (await board.read(CONTROL + 4))[0] == 0x0101
    board.check()


@cocotb.test()
async def the_static_part_says_which_one_it_is_whatever_is_written_there(dut: object) -> None:
    board = Board(dut)
    await board.start()
    want = int(os.environ["CM_STATIC_ID"])
    assert await board.read(STATIC_ID) == (want, AxiResp.OKAY)
    assert await board.write(STATIC_ID, ~want & 0xFFFF_FFFF) == AxiResp.OKAY
    assert await board.read(STATIC_ID) == (want, AxiResp.OKAY)
    board.check()


@cocotb.test()
async def a_module_says_what_it_is_unless_it_is_cut_off(dut: object) -> None:
    board = Board(dut)
    await board.start()
    want = int(os.environ["CM_IDENTITY"])
    assert await board.read(IDENTITY) == (want, AxiResp.OKAY)
    assert (await board.read(WINDOW))[0].to_bytes(4, "big") == IDS[MODULE]
    await board.write(DECOUPLE, 1)
    await board.wait_for(STATUS, 1, 1)
    assert (await board.read(IDENTITY))[0] == 0
    assert (await board.read(WINDOW))[1] == AxiResp.SLVERR
    await board.write(DECOUPLE, 0)
    await board.wait_for(STATUS, 1, 0)
    await ClockCycles(dut.clk_fclk0, 40)
    assert await board.read(IDENTITY) == (want, AxiResp.OKAY)
    board.check()


@cocotb.test()
async def decoupling_in_a_frame_closes_the_packet_and_the_next_frame_is_whole(dut: object) -> None:
    board = Board(dut)
    await board.start()
    registers, model = EXPECTED[MODULE]
    chance = random.Random(9)
    for seed in range(6):
        board.stall(seed)
        await board.source.send(AxiStreamFrame(picture(seed).tobytes()))
        await ClockCycles(dut.clk_fclk0, chance.randrange(20, 200))
        await board.write(DECOUPLE, 1)
        await board.wait_for(STATUS, 1, 1)
        await board.write(DECOUPLE, 0)
        await board.wait_for(STATUS, 1, 0)
        await ClockCycles(dut.clk_fclk0, 40)
        await board.source.wait()  # the cut frame's rest was dropped
        while not board.sink.empty():
            board.sink.recv_nowait()
        for offset, value in registers.items():
            await board.write(WINDOW + offset, value)
        await board.source.send(AxiStreamFrame(picture(50 + seed).tobytes()))
        frame = await with_timeout(board.sink.recv(), 200, "us")
        check_frame(frame, model(picture(50 + seed)))
    board.check()


@cocotb.test()
async def the_lens_follows_its_registers_unless_the_region_is_cut_off(dut: object) -> None:
    board = Board(dut)
    await board.start()
    assert (dut.ext_prr0_lens_focus.value, dut.ext_prr0_lens_zoom.value) == (1, 1)
    await board.write(WINDOW + 0x10, 15)
    await board.write(WINDOW + 0x14, 8)
    assert (dut.ext_prr0_lens_focus.value, dut.ext_prr0_lens_zoom.value) == (15, 8)
    await board.write(DECOUPLE, 1)
    await board.wait_for(STATUS, 1, 1)
    assert (dut.ext_prr0_lens_focus.value, dut.ext_prr0_lens_zoom.value) == (0, 0)
    board.check()


@cocotb.test(skip=MODULE != "edge")
async def a_frame_of_any_length_comes_out_as_long_as_it_went_in(dut: object) -> None:
    """Shorter than what the module holds back, just so long, longer, and no whole number of lines."""
    board = Board(dut)
    await board.start()
    board.stall(3)
    for length in (1, 2, LINE, LINE + 1, LINE + 2, 3 * LINE, 3 * LINE + 5):
        await board.source.send(AxiStreamFrame(bytes(length)))
        frame = await with_timeout(board.sink.recv(), 200, "us")
        assert len(frame.tdata) == length
    board.check()


@cocotb.test()
async def an_interrupt_of_one_clock_is_kept_until_it_is_cleared(dut: object) -> None:
    board = Board(dut)
    await board.start()
    await board.write(IRQ_ENABLE, 1)
    assert dut.irq.value == 0
    await board.source.send(AxiStreamFrame(picture(0).tobytes()))
    await with_timeout(board.sink.recv(), 200, "us")
    await ClockCycles(dut.clk_fclk0, 10)
    assert dut.irq.value == 1
    assert (await board.read(IRQ_STATUS))[0] == 1
    await board.write(IRQ_STATUS, 1)
    assert dut.irq.value == 0
    board.check()


@cocotb.test()
async def the_configuration_port_gets_every_word_bits_swapped(dut: object) -> None:
    board = Board(dut)
    await board.start()
    words = [0xAA995566, 0x20000000, 0x30008001, 0x0000000D]
    taken: list[int] = []

    async def watch() -> None:
        while True:
            await RisingEdge(dut.clk_fclk0)
            port = dut.icap.series7.port
            if port.CSIB.value == 0:
                taken.append(int(port.I.value))

    cocotb.start_soon(watch())
    for index, word in enumerate(words):
        dut.axis_icap_tvalid.value, dut.axis_icap_tdata.value = 1, word
        dut.axis_icap_tlast.value = int(index == len(words) - 1)
        await RisingEdge(dut.clk_fclk0)
    dut.axis_icap_tvalid.value = 0
    await ClockCycles(dut.clk_fclk0, 5)

    def swapped(word: int) -> int:
        return int.from_bytes(bytes(int(f"{byte:08b}"[::-1], 2) for byte in word.to_bytes(4, "big")), "big")

    assert taken == [swapped(word) for word in words]
    assert (await board.read(CONTROL + 0x18))[0] == len(words)
    assert (await board.read(CONTROL + 0x14))[0] == status_bits("DONE", "EOS")


def status_bits(*names: str) -> int:
    """Bits of the port's status register, as the kernel's driver defines them."""
    header = (Path(__file__).parents[2] / "kmod/include/cm_icap_port.h").read_text()
    bits = dict(re.findall(r"#define CM_ICAP_SR_([A-Z]+) BIT\((\d+)\)", header))
    return sum(1 << int(bits[name]) for name in names)


@cocotb.test()
async def an_error_of_the_configuration_port_is_in_the_bit_that_its_driver_reads(dut: object) -> None:
    board = Board(dut)
    await board.start()
    port = dut.icap.series7.port
    port.cfgerr_b.value = 0
    assert (await board.read(CONTROL + 0x14))[0] == 0  # of no load yet
    dut.axis_icap_tvalid.value, dut.axis_icap_tdata.value, dut.axis_icap_tlast.value = 1, 0xAA995566, 1
    await RisingEdge(dut.clk_fclk0)
    dut.axis_icap_tvalid.value = 0
    await ClockCycles(dut.clk_fclk0, 5)
    assert (await board.read(CONTROL + 0x14))[0] == status_bits("DONE", "FAILED", "EOS")
    port.cfgerr_b.value = 1
    await ClockCycles(dut.clk_fclk0, 2)
    assert (await board.read(CONTROL + 0x14))[0] == status_bits("DONE", "EOS")


@cocotb.test()
async def nobody_couples_a_region_while_a_load_is_under_way(dut: object) -> None:
    board = Board(dut)
    await board.start()

    async def decoupled() -> int:
        return (await board.read(CONTROL + 0x100))[0]

    async def word(value: int, last: bool) -> None:
        dut.axis_icap_tvalid.value, dut.axis_icap_tdata.value, dut.axis_icap_tlast.value = 1, value, int(last)
        await RisingEdge(dut.clk_fclk0)
        dut.axis_icap_tvalid.value = 0
        await ClockCycles(dut.clk_fclk0, 5)

    await board.write(CONTROL + 0x100, 1)
    await board.write(CONTROL + 0x100, 0)
    assert await decoupled() == 0
    await word(0xAA995566, last=False)
    await board.write(CONTROL + 0x100, 1)  # to cut off is allowed at any time
    await board.write(CONTROL + 0x100, 0)
    assert await decoupled() == 1
    await word(0x0000000D, last=True)
    assert await decoupled() == 1
    await board.write(CONTROL + 0x100, 0)
    assert await decoupled() == 0
