# SPDX-License-Identifier: Apache-2.0
"""Memories of a simulated board: they are in its windows, and answered by the module that has them."""

from __future__ import annotations

import errno
import os
import signal

import numpy as np
import pytest
from sim_support import Node

import cm.device as device
from cm.formats.bitstream import to_dma_words
from cm.simulation.software.process.child import Board
from cm.simulation.software.transport import protocol as p

SCHEMA = """
config:
  name: memories
  regions: {prr: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}}}
  modules:
    fir:
      region: prr
      mmio:
        - base_address: 0x20000
          registers: {commit: {offset: 0}}
          memories:
            taps: {offset: 0x1000, size: 0x1000}
            key: {offset: 0x2000, size: 64, access: wo}
  memories:
    table: {base_address: 0x40000, size: 0x30000}
    log: {base_address: 0x40000, offset: 0x30000, size: 64, access: ro}
  modes:
    default: {modules: [fir]}
"""
WORDS = 0x30000 // 4


@pytest.fixture
def board(tmp_path):
    (tmp_path / "memories.yaml").write_text(SCHEMA)
    with Board([tmp_path / "memories.yaml"], arguments=("--icap-rate", "0")) as running:
        yield running


def load(board):
    words = to_dma_words((board.root / "lib/firmware/cm/memories/fir.bit").read_bytes())
    with device.Icap.open(root=board.root) as icap, icap.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        icap.load(buffer, len(words))
        assert icap.wait(60).ok


def test_a_window_is_as_large_as_its_memories(board):
    assert device.find_uio(0x40000, 0x30040, board.root)[0].maps[0].size == 0x40000


def test_a_memory_holds_what_was_written_as_a_block_and_by_words(board):
    data = np.arange(WORDS, dtype="<u4") * 0x01010101
    with device.Uio.open(0x40000, board.root) as uio:
        uio.write_block(0, data.tobytes())
        assert uio.read_block(0, data.nbytes) == data.tobytes()
        uio.write(8, 5)
        assert np.frombuffer(uio.read_block(4, 12), "<u4").tolist() == [data[1], 5, data[3]]


def test_a_block_is_read_without_a_request(board):
    with device.Uio.open(0x40000, board.root) as uio:
        uio.write_block(0x100, b"12345678")
        os.kill(board.pid, signal.SIGSTOP)
        try:
            assert uio.read_block(0x100, 8) == b"12345678"
        finally:
            os.kill(board.pid, signal.SIGCONT)


def test_read_only_contents_stay_and_write_only_ones_read_as_zero(board):
    load(board)
    with device.Uio.open(0x40000, board.root) as static, device.Uio.open(0x20000, board.root) as prr:
        static.write_block(0x30000, b"x" * 64)
        assert static.read_block(0x30000, 64) == bytes(64)
        prr.write_block(0x2000, b"secret!!")
        assert prr.read_block(0x2000, 8) == bytes(8)


def test_the_memory_of_a_module_is_there_while_it_runs(board):
    with device.Uio.open(0x20000, board.root) as prr, device.Uio.open(0x1000, board.root) as static:
        prr.write_block(0x1000, b"lost")
        assert prr.read_block(0x1000, 8) == bytes.fromhex("efbeadde") * 2  # nothing is loaded
        load(board)
        assert prr.read_block(0x1000, 8) == bytes(8)
        prr.write_block(0x1000, b"kept")
        static.write(0, 1)
        assert prr.read_block(0x1000, 8) == b"\xff" * 8  # cut off
        prr.write_block(0x1000, b"lost")
        static.write(0, 0)
        assert prr.read_block(0x1000, 4) == b"kept"
        load(board)
        assert prr.read_block(0x1000, 4) == bytes(4)  # a new circuit


def test_a_block_over_several_registers_and_memories_has_their_words(board):
    load(board)
    with device.Uio.open(0x20000, board.root) as prr:
        prr.write_block(0xFFC, b"0123456789ab")
        assert prr.read_block(0xFFC, 12) == b"0123456789ab"
        prr.write_block(0, (7).to_bytes(4, "little") * 2)
        assert prr.read(0) == prr.read(4) == 7
        prr.write_block(0x1FFC, b"0123hide")
        assert prr.read_block(0x1FFC, 8) == b"0123" + bytes(4)


def test_a_block_over_the_decoupler_cuts_off(board):
    load(board)
    with device.Uio.open(0x20000, board.root) as prr, device.Uio.open(0x1000, board.root) as static:
        static.write_block(0, b"\1\0\0\0" * 4)
        assert prr.read(0) == 0xFFFFFFFF


@pytest.mark.parametrize(
    ("number", "length", "offset"), [(1, 4, 0), (0, 0, 0), (0, 6, 0), (0, 4, 2), (0, 8, 0x3FFFC), (0, 65524, 0)]
)
def test_a_block_that_does_not_exist_is_refused(board, number, length, offset):
    uio, _ = device.find_uio(0x40000, 4, board.root)
    node = Node(board.root, f"dev/{uio.node}")
    try:
        for op, data in ((p.OP_BLOCK_READ, b""), (p.OP_BLOCK_WRITE, bytes(min(length, p.BLOCK_MAX)))):
            with pytest.raises(OSError) as refused:
                node.call(op, p.BLOCK.pack(number, length, offset) + data)
            assert refused.value.errno == errno.EINVAL
    finally:
        node.close()


def test_a_block_of_another_length_than_it_says_is_refused(board):
    node = Node(board.root, "dev/uio0")
    try:
        for op, payload in (
            (p.OP_BLOCK_READ, p.BLOCK.pack(0, 4, 0) + b"more"),
            (p.OP_BLOCK_WRITE, p.BLOCK.pack(0, 8, 0) + b"less"),
            (p.OP_BLOCK_WRITE, b"short"),
        ):
            with pytest.raises(OSError) as refused:
                node.call(op, payload)
            assert refused.value.errno == errno.EINVAL
    finally:
        node.close()
