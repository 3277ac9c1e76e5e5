# SPDX-License-Identifier: Apache-2.0
"""Configuration ports: a load is started, ends with an event, and says what was wrong."""

from __future__ import annotations

import errno
import time

import pytest
from suite_board import PATIENCE, Board

import cm.device as device


def load(icap: device.Icap, words: bytes, cookie: int = 0) -> device.IcapCompletion:
    """Load ``words`` and wait for the end."""
    with icap.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        icap.load(buffer, len(words), cookie=cookie)
        return icap.wait(PATIENCE)


def test_a_load_ends_with_its_cookie_and_times(icap: device.Icap, words: bytes) -> None:
    before = time.monotonic_ns()
    done = load(icap, words, cookie=42)
    assert (done.ok, done.reason, done.cookie, done.length) == (True, "", 42, len(words))
    assert before <= done.started_ns <= done.finished_ns <= time.monotonic_ns()


def test_the_status_counts_loads(icap: device.Icap, words: bytes) -> None:
    before = icap.status().loads
    load(icap, words)
    status = icap.status()
    assert (status.state, status.errors) == (device.IcapState.IDLE, device.IcapErrors.NONE)
    assert (status.loads, status.bytes_done, status.bytes_total) == (before + 1, len(words), len(words))


def test_a_flipped_bit_is_a_crc_error(icap: device.Icap, words: bytes) -> None:
    damaged = bytearray(words)
    damaged[len(damaged) // 2] ^= 1
    done = load(icap, bytes(damaged))
    assert (done.status, done.errors, done.ok) == (-errno.EILSEQ, device.IcapErrors.CRC, False)
    assert "CRC" in done.reason
    assert icap.status().state is device.IcapState.ERROR
    assert load(icap, words).ok


def test_words_without_sync_are_an_error(icap: device.Icap, words: bytes) -> None:
    done = load(icap, bytes(4096))
    assert device.IcapErrors.NOSYNC in done.errors
    assert not done.ok
    assert load(icap, words).ok


def test_a_second_load_meanwhile_is_busy(icap: device.Icap, words: bytes, board: Board) -> None:
    with (
        device.Icap.open(board.icap or "", board.root) as other,
        icap.allocate(len(words)) as buffer,
        other.import_buffer(buffer.fd) as theirs,
    ):
        buffer.array(0, len(words))[:] = bytearray(words)
        stall = board.stall or (lambda on: None)
        stall(True)
        icap.load(buffer, len(words))
        with pytest.raises(device.DeviceBusy):
            other.load(theirs, len(words))
        stall(False)
        assert icap.wait(PATIENCE).ok
        assert other.take() is None  # the end of a load is told to the file that started it


def test_closing_waits_for_the_end_of_the_load(icap: device.Icap, words: bytes, board: Board) -> None:
    if not board.close_waits:
        pytest.skip("this board's port does not wait")
    before = icap.status().loads
    other = device.Icap.open(board.icap or "", board.root)
    buffer = other.allocate(len(words))
    buffer.array(0, len(words))[:] = bytearray(words)
    other.load(buffer, len(words))
    other.close()
    assert (icap.status().loads, icap.status().state) == (before + 1, device.IcapState.IDLE)
    buffer.close()


@pytest.mark.parametrize(("offset", "length"), [(0, 6), (2, 8), (0, 0), (0, 1 << 30), (4096, 8)])
def test_a_range_that_does_not_fit_is_refused(icap: device.Icap, offset: int, length: int) -> None:
    with icap.allocate(4096) as buffer, pytest.raises(device.DeviceInvalid):
        icap.load(buffer, length, offset)


def test_a_wait_without_load_times_out(icap: device.Icap) -> None:
    assert icap.take() is None
    with pytest.raises(device.DeviceTimeout):
        icap.wait(0.01)
