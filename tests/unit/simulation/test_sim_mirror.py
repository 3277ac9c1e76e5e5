# SPDX-License-Identifier: Apache-2.0
"""Registers of a simulated board as shared memory: always as on the bus, and unreadable once the board is gone."""

from __future__ import annotations

import mmap
import os
import signal

import pytest
from sim_support import Node, Uio

import cm.device as device
from cm.simulation.software.process.child import Board
from cm.simulation.software.transport import protocol as p

SCHEMA = """
config:
  name: mirror
  regions: {prr: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}}}
  modules: {default: {region: prr}, edge: {region: prr}}
  modes:
    default: {modules: [default]}
  registers:
    ours: {base_address: 0x2000, offset: 0x10, region: prr}
    key: {base_address: 0x2000, offset: 0x14, region: prr, access: wo}
    there: {base_address: 0x1000, offset: 0x20}
"""


@pytest.fixture
def board(tmp_path):
    (tmp_path / "mirror.yaml").write_text(SCHEMA)
    with Board([tmp_path / "mirror.yaml"]) as running:
        yield running


def same(board, name):
    """Check that memory has the value that a request returns, which is how a shim without a mirror reads."""
    with device.Uio.open(name, board.root) as uio, Uio(board.root, f"dev/uio{uio.info.number}") as node:
        for offset in range(0, 0x40, 4):
            for width in (8, 16, 32):
                assert uio.read(offset, width) == node.read(offset, width), (offset, width)


@pytest.mark.parametrize("decoupled", [0, 1])
def test_memory_and_bus_agree_in_every_state_of_a_region(board, decoupled):
    with device.Uio.open("static", board.root) as static, device.Uio.open("prr", board.root) as prr:
        static.write(0x20, 0x1234_5678)
        static.write(0, decoupled)
        prr.write(0x14, 7)
        assert static.read(0x20) == 0x1234_5678
        same(board, "static")
        same(board, "prr")
        assert prr.read(0x14) == (0xFFFFFFFF if decoupled else 0xDEADBEEF)  # nothing is loaded


def test_a_write_is_in_memory_when_it_is_answered(board):
    with device.Uio.open("static", board.root) as uio:
        for value in range(200):
            uio.write(0x20, value)
            assert uio.read(0x20) == value


def test_a_read_takes_no_request(board):
    with device.Uio.open("static", board.root) as uio:
        uio.write(0x20, 5)
        os.kill(board.pid, signal.SIGSTOP)
        try:
            assert uio.read(0x20) == 5
        finally:
            os.kill(board.pid, signal.SIGCONT)


def test_a_dead_board_has_no_registers(board):
    with device.Uio.open("static", board.root) as uio:
        uio.read(0x20)
        board.kill()
        with pytest.raises(device.DeviceGone):
            uio.read(0x20)


def test_a_client_can_neither_shorten_the_mirror_nor_write_it(board):
    """Whoever has registers mapped to read them, on a real board, cannot write them either."""
    node = Node(board.root, "dev/uio0")
    payload, fds = node.call(p.OP_MIRROR, p.MIRROR.pack(0, -1, 0))
    try:
        size = p.MIRROR.unpack(payload)[2]
        assert os.fstat(fds[0]).st_size == 2 * size
        for denied in (
            lambda: os.ftruncate(fds[0], size),
            lambda: os.pwrite(fds[0], b"1", 0),
            lambda: mmap.mmap(fds[0], size),
            lambda: os.pwrite(os.open(f"/proc/self/fd/{fds[0]}", os.O_RDWR | os.O_CLOEXEC), b"1", 0),
        ):
            with pytest.raises(PermissionError):
                denied()
        mmap.mmap(fds[0], size, prot=mmap.PROT_READ).close()
    finally:
        os.close(fds[0])
        node.close()
