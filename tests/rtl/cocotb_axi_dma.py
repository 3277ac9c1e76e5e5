# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: the DMA engine between registers, memory and streams of cocotbext-axi, which wait at random.

What a driver does is PG021's "Programming Sequence, Direct Register Mode".
"""

from __future__ import annotations

import os
import random
from dataclasses import dataclass

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, RisingEdge, with_timeout
from cocotbext.axi import (
    AxiBus,
    AxiLiteBus,
    AxiLiteMaster,
    AxiRam,
    AxiStreamBus,
    AxiStreamFrame,
    AxiStreamSink,
    AxiStreamSource,
)
from protocol import AxiChecker, Handshake, quiet

ROUNDS = int(os.environ.get("ROUNDS", "12"))
MM2S, S2MM = 0x00, 0x30
CR, SR, ADDRESS, LENGTH = 0x00, 0x04, 0x18, 0x28
RUN, RESET, IOC_EN, ERR_EN = 1 << 0, 1 << 2, 1 << 12, 1 << 14
HALTED, IDLE, INT_ERR, SLV_ERR, DEC_ERR, IOC, ERR = 1, 2, 1 << 4, 1 << 5, 1 << 6, 1 << 12, 1 << 14
SIZE = 1 << 16  # of memory
AFTER_RESET = {MM2S + CR: 0x00010002, MM2S + SR: 0x00010001, S2MM + CR: 0x00010002, S2MM + SR: 0x00010001}


@dataclass
class Bench:
    """The engine and what stands round it."""

    dut: object
    chance: random.Random
    registers: AxiLiteMaster
    memory: AxiRam
    source: AxiStreamSource
    sink: AxiStreamSink
    checker: AxiChecker

    async def read(self, offset: int) -> int:
        """A register."""
        return int(await with_timeout(self.registers.read_dword(offset), 100, "us"))

    async def write(self, offset: int, value: int) -> None:
        """Set a register."""
        await with_timeout(self.registers.write_dword(offset, value), 100, "us")

    async def until(self, offset: int, bits: int, value: int) -> int:
        """The register once the bits in it have a value."""
        for _ in range(2000):
            found = await self.read(offset)
            if found & bits == value:
                return found
        raise AssertionError(f"register {offset:#x} is {found:#x}, never {value:#x} in {bits:#x}")

    async def enable(self, channel: int) -> None:
        """Run, with interrupts."""
        await self.write(channel + CR, RUN | IOC_EN | ERR_EN)
        await self.until(channel + SR, HALTED, 0)

    async def begin(self, channel: int, address: int, length: int) -> None:
        """Start a transfer."""
        await self.write(channel + ADDRESS, address)
        await self.write(channel + LENGTH, length)

    async def ended(self, channel: int) -> int:
        """Wait for the interrupt; the status, whose interrupts are cleared."""
        line = self.dut.mm2s_introut if channel == MM2S else self.dut.s2mm_introut
        for _ in range(200_000):
            await RisingEdge(self.dut.clk)
            if line.value:
                break
        found = await self.read(channel + SR)
        await self.write(channel + SR, IOC | ERR)
        await ClockCycles(self.dut.clk, 3)
        assert not line.value, f"{channel:#x}: the interrupt stays, status {found:#x}"
        return found

    async def reset(self) -> None:
        """By the register, as drivers do it."""
        await self.write(self.chance.choice((MM2S, S2MM)) + CR, RESET)
        await self.until(MM2S + CR, RESET, 0)
        assert await self.read(S2MM + CR) & RESET == 0
        for offset, expected in AFTER_RESET.items():
            assert await self.read(offset) == expected

    @property
    def beat(self) -> dict[int, int]:
        """Bytes of a beat of each channel's stream."""
        return {MM2S: len(self.dut.m_axis_tkeep), S2MM: len(self.dut.s_axis_tkeep)}

    def place(self, channel: int, length: int) -> int:
        """An address for so many bytes, often across 4 KiB, often not at a word."""
        step = self.beat[channel]
        low, high = (0, SIZE // 2) if channel == MM2S else (SIZE // 2, SIZE)
        near = 4096 * self.chance.randrange(low // 4096 + 1, high // 4096) - self.chance.randrange(0, 300)
        address = self.chance.choice((near, self.chance.randrange(low, high)))
        return max(low, min(address, high - length - 64)) // step * step


async def bench(dut: object, seed: int, pause: float = 0.3) -> Bench:
    quiet()
    chance = random.Random(seed)
    cocotb.start_soon(Clock(dut.clk, 10, "ns").start())
    dut.resetn.value = 0
    dut.bad_read.value = dut.bad_write.value = 0
    ends = {"clock": dut.clk, "reset": dut.resetn, "reset_active_level": False}
    registers = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi"), **ends)
    memory = AxiRam(AxiBus.from_prefix(dut, "m_axi"), **ends, size=SIZE)
    dut.stream_resetn.value = 0
    own = ends | {"reset": dut.stream_resetn}
    source = AxiStreamSource(AxiStreamBus.from_prefix(dut, "s_axis"), **own)
    sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, "m_axis"), **own)
    channels = [
        *(getattr(memory.write_if, name) for name in ("aw_channel", "w_channel", "b_channel")),
        *(getattr(memory.read_if, name) for name in ("ar_channel", "r_channel")),
        source,
        sink,
    ]
    for channel in channels if pause else []:
        rate = chance.choice((0.0, pause, 2 * pause))
        channel.set_pause_generator(iter(lambda rate=rate: chance.random() < rate, None))
    checker = AxiChecker(dut, dut.clk, dut.resetn, "m_axi")
    await ClockCycles(dut.clk, 5)
    dut.resetn.value = dut.stream_resetn.value = 1
    await ClockCycles(dut.clk, 2)
    memory.write(0, chance.randbytes(SIZE))
    return Bench(dut, chance, registers, memory, source, sink, checker)


def check_bursts(checker: AxiChecker) -> None:
    """As AXI3 has them: at most 16 beats, within 4 KiB."""
    checker.check()
    for way in ("ar", "aw"):
        for beat in checker.channels[way].taken:
            address, beats = int(beat[f"m_axi_{way}addr"], 2), int(beat[f"m_axi_{way}len"], 2) + 1
            size = 1 << int(beat[f"m_axi_{way}size"], 2)
            assert beats <= 16
            assert address % size == 0
            assert address // 4096 == (address + size * beats - 1) // 4096


async def send(bench: Bench, length: int) -> None:
    """Memory → stream."""
    address = bench.place(MM2S, length)
    await bench.begin(MM2S, address, length)
    status = await bench.ended(MM2S)
    assert status & (HALTED | IDLE | IOC | ERR) == IDLE | IOC, f"{status:#x}"
    frame = await with_timeout(bench.sink.recv(), 100, "us")
    assert bytes(frame.tdata) == bench.memory.read(address, length)
    assert bench.sink.empty()


async def receive(bench: Bench, length: int, room: int) -> None:
    """Stream → memory: a packet of `length` bytes into a buffer of `room`."""
    address = bench.place(S2MM, room)
    before = bench.memory.read(SIZE // 2, SIZE // 2)
    data = bench.chance.randbytes(length)
    if bench.chance.random() < 0.5:
        await bench.source.send(AxiStreamFrame(data))
    await bench.begin(S2MM, address, room)
    if bench.source.idle():
        await bench.source.send(AxiStreamFrame(data))
    status = await bench.ended(S2MM)
    assert status & (HALTED | IDLE | IOC | ERR) == IDLE | IOC, f"{status:#x}"
    assert await bench.read(S2MM + LENGTH) == length
    at = address - SIZE // 2
    expected = before[:at] + data + before[at + length :]
    assert bench.memory.read(SIZE // 2, SIZE // 2) == expected


def some_length(chance: random.Random) -> int:
    """Bytes of a transfer: beats, words, bursts, and one more or less."""
    return max(1, chance.choice((1, 3, 8, 16, 64, 127, 128, 129, 256, 500, 1100)) + chance.randrange(-2, 3))


@cocotb.test()
async def packets_of_any_length_pass_both_ways_at_once(dut: object) -> None:
    rig = await bench(dut, 1)
    for channel in (MM2S, S2MM):
        await rig.enable(channel)
    for _ in range(ROUNDS):
        length, taken = some_length(rig.chance), some_length(rig.chance)
        room = taken + rig.chance.choice((0, 0, 1, 7, 500))
        both = cocotb.start_soon(send(rig, length)), cocotb.start_soon(receive(rig, taken, room))
        for task in both:
            await task
    check_bursts(rig.checker)


@cocotb.test()
async def registers_are_those_of_direct_register_mode(dut: object) -> None:
    rig = await bench(dut, 2, 0)
    for offset, expected in AFTER_RESET.items():
        assert await rig.read(offset) == expected
    for channel in (MM2S, S2MM):
        await rig.begin(channel, 64, 64)  # a halted channel begins nothing
        assert await rig.read(channel + SR) == 0x00010001
        await rig.write(channel + CR, 0x55AA7FF9)
        assert await rig.until(channel + CR, 0, 0) == 0x55AA7003
        assert await rig.read(channel + SR) == 0x00AA0000
        await rig.write(channel + CR, RUN)  # a threshold of 0 has no effect
        assert await rig.read(channel + CR) == 0x00AA0003
        await rig.write(channel + LENGTH, 0)  # nor has a length of 0
        assert await rig.read(channel + SR) == 0x00AA0000
        await rig.write(channel + CR, 0)
        assert await rig.until(channel + SR, HALTED, HALTED) == 0x00AA0001
        assert await rig.read(channel + ADDRESS) == 64
    for offset in (0x08, 0x10, 0x2C, 0x38, 0x60, 0x3FC):  # scatter/gather, and behind the registers
        await rig.write(offset, 0xFFFFFFFF)
        assert await rig.read(offset) == 0
    await rig.reset()
    await rig.enable(MM2S)
    await rig.begin(MM2S, 0, 64)
    await rig.write(MM2S + LENGTH, 8)  # one at a time: of no effect, unless the first has ended
    await rig.until(MM2S + SR, IDLE, IDLE)
    assert len((await rig.sink.recv()).tdata) == 64
    await rig.write(MM2S + CR, RUN)  # interrupts off: the line falls, the bit stays
    await ClockCycles(dut.clk, 3)
    assert not dut.mm2s_introut.value
    assert await rig.read(MM2S + SR) & IOC


@cocotb.test()
async def errors_of_memory_end_a_transfer_until_a_reset(dut: object) -> None:
    rig = await bench(dut, 3)
    for number, (bad, bit) in enumerate(((2, SLV_ERR), (3, DEC_ERR))):
        for channel, line in ((MM2S, dut.bad_read), (S2MM, dut.bad_write)):
            await rig.enable(channel)
            await rig.begin(channel, rig.place(channel, 2048), 2048)
            if channel == S2MM:
                await rig.source.send(AxiStreamFrame(bytes(2048)))
            await ClockCycles(dut.clk, (5, 150)[number])
            line.value = bad
            status = await rig.ended(channel)
            line.value = 0
            assert status & ERR
            assert status & bit
            assert bool(status & INT_ERR) == (channel == S2MM)
            await rig.until(channel + SR, HALTED | IDLE, HALTED)
            await rig.write(channel + CR, RUN)
            assert await rig.read(channel + CR) & RUN == 0  # only a reset clears errors
            await clean(rig)
            await rig.enable(channel)
            await (send(rig, 300) if channel == MM2S else receive(rig, 300, 300))
    check_bursts(rig.checker)


async def clean(rig: Bench) -> None:
    """Reset, and a module that is, too: half a packet is nobody's."""
    await rig.reset()
    rig.dut.stream_resetn.value = 0
    await ClockCycles(rig.dut.clk, 3)
    rig.source.clear()
    rig.sink.clear()
    rig.dut.stream_resetn.value = 1
    await ClockCycles(rig.dut.clk, 3)


@cocotb.test()
async def a_packet_longer_than_its_buffer_fills_it_and_is_an_internal_error(dut: object) -> None:
    rig = await bench(dut, 4)
    beat = rig.beat[S2MM]
    for room, length in ((64, 65), (200 * beat, 300 * beat), (129, 129 + beat), (beat, 2 * beat)):
        await rig.enable(S2MM)
        address = rig.place(S2MM, 4096)
        before = rig.memory.read(address, room + 64)
        data = rig.chance.randbytes(length)
        await rig.source.send(AxiStreamFrame(data))
        await rig.begin(S2MM, address, room)
        status = await rig.ended(S2MM)
        assert status & (ERR | INT_ERR | SLV_ERR | DEC_ERR | IOC) == ERR | INT_ERR
        assert rig.memory.read(address, room + 64) == data[:room] + before[room:]
        await clean(rig)
    if beat > 1:
        for channel in (MM2S, S2MM):
            if rig.beat[channel] > 1:
                await rig.enable(channel)
                await rig.begin(channel, SIZE // 2 + 1, 64)  # there is no realignment
                assert await rig.ended(channel) & (ERR | INT_ERR | IOC) == ERR | INT_ERR
                await rig.until(channel + SR, HALTED, HALTED)
                await clean(rig)
    check_bursts(rig.checker)


@cocotb.test()
async def transfers_are_stopped_at_any_clock_and_the_next_are_whole(dut: object) -> None:
    rig = await bench(dut, 5)
    for number in range(ROUNDS):
        for channel in (MM2S, S2MM):
            await rig.enable(channel)
        await rig.begin(MM2S, rig.place(MM2S, 2000), 2000)
        await rig.source.send(AxiStreamFrame(rig.chance.randbytes(2000)))
        await rig.begin(S2MM, rig.place(S2MM, 3000), 2000)
        await ClockCycles(dut.clk, rig.chance.randrange(0, 120))
        if number % 2:
            for channel in (MM2S, S2MM):
                await rig.write(channel + CR, 0)
                await rig.until(channel + SR, HALTED | IDLE, HALTED)
        await clean(rig)
        reads = rig.checker.channels["ar"].beats
        await ClockCycles(dut.clk, 50)
        assert rig.checker.channels["ar"].beats == reads  # nothing goes on behind a reset
        for channel in (MM2S, S2MM):
            await rig.enable(channel)
        await send(rig, some_length(rig.chance))
        await receive(rig, 70, 80)
    check_bursts(rig.checker)


def hold(rig: Bench, held: bool, channels: tuple[str, ...] = ("aw", "w", "b", "ar", "r")) -> None:
    """Memory takes and answers nothing, or does again."""
    for name in channels:
        side = rig.memory.read_if if name in ("ar", "r") else rig.memory.write_if
        getattr(side, f"{name}_channel").pause = held


@cocotb.test()
async def a_reset_and_a_halt_wait_for_bursts_that_have_begun(dut: object) -> None:
    rig = await bench(dut, 7, 0)
    for stopped, held in ((RESET, ()), (RESET, ("r", "b")), (0, ("r", "b")), (0, ("ar", "aw")), (0, ("r", "w"))):
        for channel in (MM2S, S2MM):
            await rig.enable(channel)
        await rig.begin(MM2S, rig.place(MM2S, 2000), 2000)
        await rig.source.send(AxiStreamFrame(rig.chance.randbytes(2000)))
        await rig.begin(S2MM, rig.place(S2MM, 2000), 2000)
        await ClockCycles(dut.clk, 60)
        hold(rig, True, held or ("aw", "w", "b", "ar", "r"))
        await ClockCycles(dut.clk, 200)
        for channel in (MM2S, S2MM):
            await rig.write(channel + CR, stopped)
        for _ in range(10):
            if stopped:
                assert await rig.read(S2MM + CR) & RESET
            else:
                assert not await rig.read(S2MM + SR) & HALTED
                assert not await rig.read(MM2S + SR) & HALTED
        hold(rig, False)
        for channel in (MM2S, S2MM):
            await rig.until(channel + SR, HALTED, HALTED)
        await clean(rig)
        for channel in (MM2S, S2MM):
            await rig.enable(channel)
        await send(rig, 300)
        await receive(rig, 300, 300)
        await clean(rig)
    check_bursts(rig.checker)


@cocotb.test()
async def memory_that_stands_still_loses_nothing(dut: object) -> None:
    rig = await bench(dut, 8, 0)
    for channel in (MM2S, S2MM):
        await rig.enable(channel)
        hold(rig, channel == S2MM)
        task = cocotb.start_soon(send(rig, 3000) if channel == MM2S else receive(rig, 3000, 3000))
        for _ in range(6):
            await ClockCycles(dut.clk, 400 if channel == S2MM else 37)
            hold(rig, not rig.memory.write_if.w_channel.pause)
        hold(rig, False)
        await task
    check_bursts(rig.checker)


@cocotb.test()
async def an_end_without_bytes_ends_a_full_buffer_and_writes_nothing(dut: object) -> None:
    """As HLS cores and width converters may send it: TLAST on a beat of which TKEEP has no byte."""
    rig = await bench(dut, 9)
    beat = rig.beat[S2MM]
    await rig.enable(S2MM)
    for beats in (8, 64, 3):
        address, room = SIZE // 2 + 64, beats * beat
        data = rig.chance.randbytes(room)
        await rig.source.send(AxiStreamFrame(data + bytes(beat), tkeep=[1] * room + [0] * beat))
        await rig.begin(S2MM, address, room)
        assert await rig.ended(S2MM) & (ERR | IOC) == IOC
        assert await rig.read(S2MM + LENGTH) == room
        assert rig.memory.read(address, room) == data
    for request in rig.checker.channels["aw"].taken:
        size, length = 1 << int(request["m_axi_awsize"], 2), int(request["m_axi_awlen"], 2) + 1
        assert int(request["m_axi_awaddr"], 2) + size * length <= SIZE // 2 + 64 + max(64 * beat, 8)
    check_bursts(rig.checker)


@cocotb.test()
async def a_stream_at_full_speed_keeps_its_beats(dut: object) -> None:
    """No gaps of its own making beyond memory's delay: a picture's line takes little more than its beats."""
    rig = await bench(dut, 6, 0)
    watch = Handshake(dut, dut.clk, dut.resetn, "MM2S", "m_axis_tvalid", "m_axis_tready", ["m_axis_tdata"])
    for channel in (MM2S, S2MM):
        await rig.enable(channel)
    for channel, work in ((MM2S, rig.begin), (S2MM, rig.begin)):
        begun = cocotb.utils.get_sim_time("ns")
        if channel == S2MM:
            await rig.source.send(AxiStreamFrame(bytes(4096)))
        await work(channel, SIZE // 2, 4096)
        await rig.ended(channel)
        clocks = (cocotb.utils.get_sim_time("ns") - begun) / 10
        beats = 4096 / rig.beat[channel]
        assert clocks < 1.6 * beats + 100, f"{channel:#x}: {clocks} clocks for {beats} beats"
    assert not watch.errors
