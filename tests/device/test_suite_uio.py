# SPDX-License-Identifier: Apache-2.0
"""UIO devices: registers hold, interrupts count and stay masked until they are enabled."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from suite_board import PATIENCE, Board

import cm.device as device


@pytest.fixture
def scratch(board: Board) -> int:
    if board.scratch is None:
        pytest.skip("the board has no scratch register")
    return board.scratch


class Line:
    """A device with an interrupt, and what raises and clears it."""

    def __init__(self, uio: device.Uio, board: Board) -> None:
        self.uio = uio
        self._board = board

    def fire(self) -> None:
        if self._board.raise_interrupt is not None:
            self._board.raise_interrupt()
        else:
            assert self._board.trigger is not None
            self.uio.write(*self._board.trigger)

    def wait(self) -> int:
        count = self.uio.wait(PATIENCE)
        if self._board.acknowledge is not None:
            self.uio.write(*self._board.acknowledge)
        return count


@pytest.fixture
def line(board: Board) -> Iterator[Line]:
    if board.irq is None or (board.raise_interrupt is None and board.trigger is None):
        pytest.skip("the board has no way to raise an interrupt")
    with device.Uio.open(board.irq, board.root) as opened:
        yield Line(opened, board)


@pytest.mark.parametrize("value", [0, 1, 0xFFFF_FFFF, 0x1234_5678])
def test_a_register_holds_what_was_written(uio: device.Uio, scratch: int, value: int) -> None:
    uio.write(scratch, value)
    assert uio.read(scratch) == value


def test_two_files_see_the_same_register(uio: device.Uio, scratch: int, board: Board) -> None:
    uio.write(scratch, 0xC0FFEE)
    with device.Uio.open(uio.maps[0].address, board.root) as other:
        assert (other.name, other.read(scratch)) == (uio.name, 0xC0FFEE)


def test_an_offset_behind_the_window_is_refused(uio: device.Uio) -> None:
    with pytest.raises(device.DeviceInvalid):
        uio.read(uio.maps[0].size)


@pytest.fixture
def memory(board: Board) -> tuple[int, int]:
    if board.memory is None:
        pytest.skip("the board has no memory for tests")
    offset, length = board.memory
    return offset, length


def test_memory_holds_a_block(uio: device.Uio, memory: tuple[int, int]) -> None:
    offset, length = memory
    data = np.random.default_rng(7).integers(0, 256, length, np.uint8)
    uio.write_block(offset, data.data)
    assert uio.read_block(offset, length) == data.tobytes()
    assert uio.read(offset + 8) == int.from_bytes(data[8:12].tobytes(), "little")
    uio.write(offset + length - 4, 0x1234_5678)
    assert uio.read_block(offset + length - 8, 8) == data[-8:-4].tobytes() + bytes.fromhex("78563412")


def test_a_block_changes_its_words_only(uio: device.Uio, memory: tuple[int, int]) -> None:
    offset, length = memory
    uio.write_block(offset, bytes(length))
    uio.write_block(offset + 0x10, b"12345678")
    assert uio.read_block(offset, 0x20) == bytes(0x10) + b"12345678" + bytes(8)


def test_a_block_behind_the_window_or_beside_the_words_is_refused(uio: device.Uio, memory: tuple[int, int]) -> None:
    size = uio.maps[0].size
    for offset, length in ((size - 4, 8), (size, 4), (memory[0] + 2, 4), (memory[0], 6)):
        with pytest.raises(device.DeviceInvalid):
            uio.read_block(offset, length)
        with pytest.raises(device.DeviceInvalid):
            uio.write_block(offset, bytes(length))


def test_an_interrupt_is_counted(line: Line) -> None:
    line.uio.enable_interrupt()
    line.fire()
    first = line.wait()
    line.uio.enable_interrupt()
    line.fire()
    assert line.wait() == (first + 1) & 0xFFFF_FFFF
    assert line.uio.take() is None


def test_an_interrupt_stays_masked_until_it_is_enabled_again(line: Line) -> None:
    line.uio.enable_interrupt()
    line.fire()
    line.wait()
    line.fire()
    assert line.uio.take() is None
    line.uio.enable_interrupt()
    line.wait()


def test_every_open_file_hears_an_interrupt(line: Line, board: Board) -> None:
    with device.Uio.open(board.irq or "", board.root) as other:
        line.uio.enable_interrupt()
        line.fire()
        assert line.wait() == other.wait(PATIENCE)


def test_without_an_interrupt_the_wait_times_out(line: Line) -> None:
    with pytest.raises(device.DeviceTimeout):
        line.uio.wait(0.01)
