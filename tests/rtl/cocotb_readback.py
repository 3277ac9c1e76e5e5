# SPDX-License-Identifier: Apache-2.0
"""The configuration port with its way back, at the model of ICAPE2 or ICAPE3 (CM_PORT), on random data."""

from __future__ import annotations

import os
import random
import struct
from collections.abc import Iterator, Sequence

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, RisingEdge, with_timeout
from cocotbext.axi import AxiStreamBus, AxiStreamFrame, AxiStreamSink, AxiStreamSource

ULTRASCALE = os.environ["CM_PORT"] == "ICAPE3"
FRAME, PIPELINE = (93, 25) if ULTRASCALE else (101, 0)
DEPTH = 1 << int(os.environ["CM_DEPTH_BITS"])
SYNC, NOP, DUMMY = 0xAA995566, 0x20000000, 0xFFFFFFFF
WCFG, RCFG, RCRC, DESYNC = 1, 4, 7, 13
CLOSING = [0x30008001, RCRC, NOP, 0x30008001, DESYNC, NOP, NOP]


def packet(words: Sequence[int]) -> AxiStreamFrame:
    return AxiStreamFrame(struct.pack(f"<{len(words)}I", *words))


def command(value: int) -> list[int]:
    return [0x30008001, value]


def loading(far: int, frames: Sequence[Sequence[int]]) -> list[int]:
    """A load of frames, with the pad frame that pushes the last one out of the buffer."""
    data = [word for frame in (*frames, [0] * FRAME) for word in frame]
    head = [DUMMY, SYNC, NOP, *command(RCRC), 0x30002001, far, *command(WCFG), NOP, 0x30004000, 0x50000000 | len(data)]
    return [*head, *data, *command(DESYNC), NOP]


def request(far: int, frames: int) -> list[int]:
    """What asks for frames (UG470 and UG570, "Configuration Memory Read Procedure (SelectMAP)")."""
    count = PIPELINE + (frames + 1) * FRAME
    head = [DUMMY, SYNC, NOP, *command(RCRC), NOP, *command(RCFG), NOP, 0x30002001, far]
    return [*head, 0x28006000, 0x48000000 | count, *[NOP] * 64]


def register(number: int) -> list[int]:
    return [DUMMY, SYNC, NOP, 0x28000001 | number << 13, NOP, NOP]


def noise(seed: int) -> Iterator[bool]:
    source = random.Random(seed)
    while True:
        yield source.random() < 0.5


class Rig:
    """The port with a stream to it and one from it, watched for what would abort."""

    def __init__(self, dut: object) -> None:
        self.dut = dut
        cocotb.start_soon(Clock(dut.clk, 10, "ns").start())
        self.source = AxiStreamSource(AxiStreamBus.from_prefix(dut, "s"), dut.clk, dut.resetn, reset_active_level=False)
        self.sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, "m"), dut.clk, dut.resetn, reset_active_level=False)
        self.port = dut.ultrascale.port if ULTRASCALE else dut.series7.port

    async def start(self) -> None:
        self.dut.resetn.value = 0
        await ClockCycles(self.dut.clk, 4)
        self.dut.resetn.value = 1
        cocotb.start_soon(self._watch())
        await ClockCycles(self.dut.clk, 2)

    async def _watch(self) -> None:
        """RDWRB changes only while CSIB is high, before and after."""
        before = (1, int(self.dut.rdwrb.value))
        while True:
            await RisingEdge(self.dut.clk)
            now = (int(self.dut.csib.value), int(self.dut.rdwrb.value))
            assert now[1] == before[1] or (now[0], before[0]) == (1, 1), "the port was made to abort"
            before = now

    async def send(self, words: Sequence[int]) -> None:
        await self.source.send(packet(words))
        await with_timeout(self.source.wait(), 2, "ms")
        while not (int(self.dut.status.value) & 1):
            await RisingEdge(self.dut.clk)

    async def ask(self, words: Sequence[int]) -> list[int]:
        """One answer: what came, until TLAST; the closing words are not sent yet."""
        await self.source.send(packet(words))
        frame = await with_timeout(self.sink.recv(), 2, "ms")
        data = bytes(frame.tdata)
        return list(struct.unpack(f"<{len(data) // 4}I", data))

    async def frames(self, far: int, count: int) -> list[list[int]]:
        words = await self.ask(request(far, count))
        await self.send(CLOSING)
        assert len(words) == PIPELINE + (count + 1) * FRAME
        data = words[PIPELINE + FRAME :]
        return [data[start : start + FRAME] for start in range(0, len(data), FRAME)]


def made(seed: int, count: int) -> list[list[int]]:
    source = random.Random(seed)
    return [[source.getrandbits(32) for _ in range(FRAME)] for _ in range(count)]


@cocotb.test()
async def frames_come_back_as_they_were_loaded(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    first, second = made(1, 3), made(2, 2)
    await rig.send(loading(5, first))
    await rig.send(loading(40, second))
    assert await rig.frames(5, 3) == first
    assert await rig.frames(40, 2) == second
    assert await rig.frames(6, 1) == first[1:2]
    assert await rig.frames(8, 1) == [[0] * FRAME]  # the pad frame of a load stays in the buffer
    assert rig.sink.empty()
    assert int(dut.status.value) == 1


@cocotb.test()
async def registers_answer_with_one_word(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    status = await rig.ask(register(7))
    await rig.send(CLOSING)
    assert status == [0x000078FC]
    crc = [DUMMY, SYNC, 0x30000001, 0x12345678, NOP]
    await rig.send(crc)
    assert int(rig.port.core.failed.value) == 1
    assert await rig.ask(register(7)) == [0x000078FC]  # a sync word takes the error back
    await rig.send(CLOSING)


@cocotb.test()
async def a_reader_that_pauses_gets_every_word(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    count = max(1, DEPTH // FRAME - 1)
    if DEPTH < 2 * FRAME + PIPELINE:
        return
    frames = made(3, count)
    await rig.send(loading(0, frames))
    rig.source.set_pause_generator(noise(1))
    rig.sink.set_pause_generator(noise(2))
    for _ in range(4):
        assert await rig.frames(0, count) == frames


@cocotb.test()
async def a_reader_that_is_too_slow_gets_a_packet_that_ends_early(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    count = DEPTH // FRAME + 3
    frames = made(4, count)
    await rig.send(loading(0, frames))
    rig.sink.pause = True
    await rig.source.send(packet(request(0, count)))
    await ClockCycles(dut.clk, (count + 4) * FRAME + 100)
    rig.sink.pause = False
    frame = await with_timeout(rig.sink.recv(), 1, "ms")
    words = struct.unpack(f"<{len(frame.tdata) // 4}I", bytes(frame.tdata))
    await rig.send(CLOSING)
    whole = [0] * (PIPELINE + FRAME) + [word for one in frames for word in one]
    assert DEPTH <= len(words) < len(whole)
    assert list(words) == whole[: len(words)]
    assert await rig.frames(0, count) == frames


@cocotb.test()
async def an_answer_that_nobody_takes_ends_with_the_next_words(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    frames = made(5, 2)
    await rig.send(loading(7, frames))
    for wait in (1, 20, 90, 2 * FRAME, 6 * FRAME):  # in the request, while the port is read, and afterwards
        rig.sink.pause = True
        await rig.source.send(packet(request(7, 2)))
        await ClockCycles(dut.clk, wait)
        await rig.send(CLOSING)
        assert int(dut.m_tvalid.value) == 0
        assert int(rig.port.core.synced.value) == 0
        assert int(rig.port.core.asked.value) == 0  # it does not stand in the middle of a packet
        rig.sink.clear()
        rig.sink.pause = False
        assert await rig.frames(7, 2) == frames
    changed = made(6, 2)
    await rig.send(loading(7, changed))
    assert await rig.frames(7, 2) == changed


@cocotb.test()
async def a_reset_in_the_middle_does_not_abort(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    frames = made(7, 2)
    await rig.send(loading(7, frames))
    for wait in (75, 90, 150, 300):
        await rig.source.send(packet(request(7, 2)))
        await ClockCycles(dut.clk, wait)
        dut.resetn.value = 0
        await ClockCycles(dut.clk, 3)
        dut.resetn.value = 1
        rig.source.clear()
        rig.sink.clear()
        assert int(rig.port.core.aborting.value) == 0
        await rig.send(CLOSING)
        assert await rig.frames(7, 2) == frames


@cocotb.test()
async def reads_between_loads_change_nothing(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    rig.source.set_pause_generator(noise(8))
    chance = random.Random(9)
    await rig.send(loading(0, [[0] * FRAME] * 32))
    known = {far: [0] * FRAME for far in range(32)}
    for turn in range(12):
        far, count = chance.randrange(28), chance.randrange(1, 4)
        if turn % 3 == 0:
            frames = made(turn, count)
            await rig.send(loading(far, frames))
            known |= {far + index: frame for index, frame in enumerate(frames)}
        else:
            assert await rig.frames(far, count) == [known[far + index] for index in range(count)]


@cocotb.test()
async def a_region_can_be_coupled_during_a_read_and_not_during_a_load(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    seen: set[int] = set()

    async def look() -> None:
        while True:
            await RisingEdge(dut.clk)
            seen.add(int(dut.status.value) >> 2)

    watching = cocotb.start_soon(look())
    await rig.frames(0, 2)
    assert seen == {0}
    await rig.send(loading(0, made(1, 1)))
    assert seen == {0, 1}
    seen.clear()
    await rig.send([DUMMY] * 300)  # what is not understood, as encrypted words are not, counts as a load
    assert seen == {0, 1}
    watching.cancel()


@cocotb.test(skip=not ULTRASCALE)
async def a_port_that_is_taken_away_ends_the_packet_early(dut: object) -> None:
    rig = Rig(dut)
    await rig.start()
    frames = made(10, 2)
    await rig.send(loading(3, frames))
    await rig.source.send(packet(request(3, 2)))
    while int(dut.rdwrb.value) == 0 or int(dut.csib.value) == 1:
        await RisingEdge(dut.clk)
    await ClockCycles(dut.clk, 60)
    rig.port.stall.value = 1
    await ClockCycles(dut.clk, 5)
    rig.port.stall.value = 0
    frame = await with_timeout(rig.sink.recv(), 1, "ms")
    assert 50 <= len(frame.tdata) // 4 < PIPELINE + 3 * FRAME
    await rig.send(CLOSING)
    assert int(rig.port.core.synced.value) == 0
