# SPDX-License-Identifier: Apache-2.0
"""Blocks of a UIO window from Python, on simulated nodes and on a mapped device."""

from __future__ import annotations

import errno
import gc
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_node import REG, REG_WRITE, FakeNode, Reply, attribute, uio_class

import cm.device as device

SIZE = 0x100000


class Words:
    """A node's handler: a register file that serves blocks and single accesses."""

    def __init__(self) -> None:
        self.words: dict[int, int] = {}
        self.error = 0
        self.asked = threading.Event()
        self.go_on = threading.Event()
        self.go_on.set()

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        index, width, offset, value = REG.unpack(payload)
        assert width == 32
        self.asked.set()
        assert self.go_on.wait(60)
        if op == REG_WRITE:
            self.words[offset] = value
        return self.error, REG.pack(index, width, offset, self.words.get(offset, 0)), []


@pytest.fixture
def node(tmp_path: Path) -> Iterator[tuple[device.Uio, Words, FakeNode]]:
    uio_class(tmp_path, 0, "node", [(0x2000, 0x100), (0x8000, 0x40)])
    words = Words()
    with FakeNode(tmp_path, "dev/uio0", words) as fake, device.Uio.open("node", tmp_path) as opened:
        yield opened, words, fake


@pytest.fixture
def mapped(tmp_path: Path) -> Iterator[device.Uio]:
    """A character device whose mapping is memory."""
    uio_class(tmp_path, 0, "mapped", [(0x2000, SIZE)])
    attribute(tmp_path, "dev/other", "")
    (tmp_path / "dev/uio0").symlink_to("/dev/zero")
    with device.Uio.open("mapped", tmp_path) as opened:
        yield opened


def test_a_mapped_window_holds_a_block(mapped: device.Uio) -> None:
    data = np.random.default_rng(1).integers(0, 256, SIZE, np.uint8)
    mapped.write_block(0, data.data)
    assert mapped.read_block(0, SIZE) == data.tobytes()
    assert mapped.read(0x40) == int.from_bytes(data[0x40:0x44].tobytes(), "little")
    mapped.write_block(0x40, b"\1\2\3\4")
    assert mapped.read_block(0x3C, 12) == data[0x3C:0x40].tobytes() + b"\1\2\3\4" + data[0x44:0x48].tobytes()


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, lambda data: np.frombuffer(data, np.uint16)])
def test_anything_with_bytes_in_a_row_can_be_written(mapped: device.Uio, kind: type) -> None:
    mapped.write_block(8, kind(b"12345678"))
    assert mapped.read_block(8, 8) == b"12345678"


def test_data_that_were_read_belong_to_the_caller(mapped: device.Uio) -> None:
    found = np.frombuffer(mapped.read_block(0, 16), "<u4")
    found[:] = 7
    assert mapped.read(0) == 0


def test_a_second_window_is_read_too(node: tuple[device.Uio, Words, FakeNode]) -> None:
    uio, words, _ = node
    uio.write_block(0x20, b"\5\0\0\0\6\0\0\0", map=1)
    assert words.words == {0x20: 5, 0x24: 6}
    assert uio.read_block(0x24, 4, map=1) == b"\6\0\0\0"


@pytest.mark.parametrize(("offset", "length"), [(2, 4), (0, 6), (0xFC, 8), (-4, 4), (1 << 64, 4), (0, 0x104)])
def test_what_does_not_fit_is_refused_with_what_would(
    node: tuple[device.Uio, Words, FakeNode], offset: int, length: int
) -> None:
    uio, words, _ = node
    for use in (lambda: uio.read_block(offset, length), lambda: uio.write_block(offset, bytes(length))):
        with pytest.raises(device.DeviceInvalid, match=r"map 0: 0x100 bytes.*multiples of 4"):
            use()
    assert not words.asked.is_set()


def test_a_length_that_no_window_has_takes_no_memory(node: tuple[device.Uio, Words, FakeNode]) -> None:
    for length in (-4, 1 << 62):
        with pytest.raises(device.DeviceInvalid):
            node[0].read_block(0, length)


def test_a_bus_that_fails_is_an_error_with_the_place(node: tuple[device.Uio, Words, FakeNode]) -> None:
    uio, words, _ = node
    words.error = errno.EIO
    with pytest.raises(device.DeviceError, match="read 8 bytes at offset 0x10 of") as failed:
        uio.read_block(0x10, 8)
    assert failed.value.errno == errno.EIO
    with pytest.raises(device.DeviceError, match="write 8 bytes at offset 0x10 of") as failed:
        uio.write_block(0x10, bytes(8))
    failed.value.args = (failed.value,)  # garbage only together: cffi's views in its frames must have ended before
    del failed
    gc.collect()


def test_a_board_that_dies_is_gone(node: tuple[device.Uio, Words, FakeNode]) -> None:
    node[2].close()
    with pytest.raises(device.DeviceGone):
        node[0].read_block(0, 8)
    with pytest.raises(device.DeviceGone):
        node[0].write_block(0, bytes(8))


def test_after_close_nothing_is_read(mapped: device.Uio) -> None:
    mapped.close()
    with pytest.raises(device.DeviceClosed):
        mapped.read_block(0, 4)
    with pytest.raises(device.DeviceClosed):
        mapped.write_block(0, bytes(4))


def test_python_runs_on_while_a_block_is_read(node: tuple[device.Uio, Words, FakeNode]) -> None:
    uio, words, _ = node
    words.go_on.clear()
    found: list[bytearray] = []
    reader = threading.Thread(target=lambda: found.append(uio.read_block(0, 16)))
    reader.start()
    assert words.asked.wait(60)  # the reader is inside the shim, and the node's thread and this one run
    words.go_on.set()
    reader.join(60)
    assert found == [bytearray(16)]
