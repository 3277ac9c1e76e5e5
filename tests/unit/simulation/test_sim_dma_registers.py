# SPDX-License-Identifier: Apache-2.0
"""The simulated AXI DMA by its registers (PG021, simple mode), where a schema lays them open."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from manager_process import served, short_folder, until

import cm
from cm.tools.bench.cases.pynq import SCHEMA

MM2S, S2MM = 0x00, 0x30
CONTROL, STATUS, ADDRESS, LENGTH = 0x00, 0x04, 0x18, 0x28
HALTED, IDLE, INTERNAL, DECODE, DONE = 1, 2, 0x10, 0x40, 0x1000


@pytest.fixture(scope="module")
def board() -> Iterator[cm.Board]:
    with short_folder() as folder:
        (folder / "loop.yaml").write_text(SCHEMA)
        with served(schemas=folder / "loop.yaml") as (manager, _), manager.connected() as found:
            found.load("loop")
            yield found


@pytest.fixture
def engine(board: cm.Board) -> cm.Block:
    found = board.blocks["dma"]
    found.write(CONTROL, 4)
    for base in (MM2S, S2MM):
        assert found.read(base + STATUS) & (HALTED | IDLE) == HALTED
        found.write(base + CONTROL, 1)
        assert found.read(base + STATUS) & (HALTED | IDLE) == 0
    return found


def begin(engine: cm.Block, base: int, address: int, length: int) -> None:
    engine.write(base + ADDRESS, address & 0xFFFFFFFF)
    engine.write(base + ADDRESS + 4, address >> 32)
    engine.write(base + LENGTH, length)


def told(engine: cm.Block, base: int, bits: int) -> bool:
    return until(lambda: engine.read(base + STATUS) & bits == bits)


def test_a_packet_goes_there_and_back(board: cm.Board, engine: cm.Block) -> None:
    source, result = board.allocate(300), board.allocate(400)
    for value in (1, 2):
        source[:] = np.arange(300) + value
        begin(engine, S2MM, result.device_address, 400)
        begin(engine, MM2S, source.device_address, 300)
        assert told(engine, MM2S, IDLE | DONE)
        assert told(engine, S2MM, IDLE | DONE)
        assert (engine.read(S2MM + LENGTH), bool((result[:300] == source).all())) == (300, True)
        engine.write(S2MM + STATUS, DONE)
        assert engine.read(S2MM + STATUS) & (IDLE | DONE) == IDLE


@pytest.mark.parametrize(("length", "offset", "bit"), [(0, 0, INTERNAL), (64, 1 << 32, DECODE)])
def test_what_cannot_be_moved_halts_the_engine(
    board: cm.Board, engine: cm.Block, length: int, offset: int, bit: int
) -> None:
    begin(engine, MM2S, board.allocate(64).device_address + offset, length)
    assert told(engine, MM2S, HALTED | bit)
    engine.write(MM2S + STATUS, 0x7000)
    assert engine.read(MM2S + STATUS) & bit


def test_a_packet_that_is_too_long_halts_the_engine(board: cm.Board, engine: cm.Block) -> None:
    source, result = board.allocate(64), board.allocate(64)
    begin(engine, S2MM, result.device_address, 32)
    begin(engine, MM2S, source.device_address, 64)
    assert told(engine, S2MM, HALTED | INTERNAL)
    assert told(engine, MM2S, IDLE)


def test_a_reset_ends_what_is_under_way(board: cm.Board, engine: cm.Block) -> None:
    source, lost, result = (board.allocate(64) for _ in range(3))
    begin(engine, S2MM, lost.device_address, 64)
    engine.write(CONTROL, 4)
    engine.write(S2MM + LENGTH, 64)  # it is halted
    for base in (MM2S, S2MM):
        engine.write(base + CONTROL, 1)
    source[:] = 7
    begin(engine, S2MM, result.device_address, 64)
    begin(engine, MM2S, source.device_address, 64)
    assert told(engine, S2MM, DONE)
    assert (set(result.tolist()), set(lost.tolist())) == ({7}, {0})
