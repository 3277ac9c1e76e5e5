# SPDX-License-Identifier: Apache-2.0
"""Configuration ports: a load is started, ends with an event, and says what was wrong."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from suite_board import PATIENCE, Board

import cm.device as device
from cm.formats.bitstream import device_by_idcode, open_image
from cm.formats.bitstream.mask import Mask
from cm.formats.bitstream.readback import LoadedFrames, Slice

PAGE = 4096


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


Reads = Callable[[bytes, int, bytes], tuple[device.IcapCompletion, bytes]]


@pytest.fixture
def reads(icap: device.Icap) -> Reads:
    """Write words, read `length` bytes, write words: the end of it, and what came."""
    if not icap.info.readable:
        pytest.skip("this board's port has no way back")

    def read(request: bytes, length: int, closing: bytes) -> tuple[device.IcapCompletion, bytes]:
        with icap.allocate(PAGE * 4 + length) as buffer:  # each part on pages of its own, as a cache's lines want it
            whole = buffer.array(0, PAGE * 4 + length)
            buffer.sync_begin(write=True)
            whole[: len(request)] = bytearray(request)
            whole[PAGE : PAGE + len(closing)] = bytearray(closing)
            buffer.sync_end(write=True)
            begin = 2 * PAGE
            ask, end = slice(0, len(request)), slice(PAGE, PAGE + len(closing))
            icap.read(buffer, ask, slice(begin, begin + length), end, cookie=7)
            done = icap.wait(PATIENCE)
            buffer.sync_begin(write=False)
            reply = bytes(whole[begin : begin + done.length])
            buffer.sync_end(write=False)
            return done, reply

    return read


@pytest.fixture
def slices(icap: device.Icap, words: bytes, board: Board) -> list[Slice]:
    """The frames of the good bitstream, which is loaded, in the parts in which they are read."""
    assert load(icap, words).ok
    part = device_by_idcode(icap.info.idcode)
    image = open_image(Path(board.bitstream or "").read_bytes())
    found = list(LoadedFrames(part, image, Mask(lambda _: {}, "none")).slices(16)) if part else []
    if not found:
        pytest.skip("the frames of this board's device are not known")
    return found


def test_frames_read_back_are_those_that_were_loaded(
    icap: device.Icap, words: bytes, reads: Reads, slices: list[Slice]
) -> None:
    for part in slices:
        done, reply = reads(part.request, part.reply_length, part.closing)
        assert (done.ok, done.cookie, done.length) == (True, 7, part.reply_length)
        assert part.judge(reply) == ()
        assert any(reply)
    assert load(icap, words).ok
    assert icap.status().state is device.IcapState.IDLE


def test_an_answer_that_is_shorter_than_asked_for_is_a_time_out(reads: Reads, slices: list[Slice]) -> None:
    part = slices[0]
    done, reply = reads(part.request, part.reply_length + 64, part.closing)
    assert (done.status, done.errors, done.length) == (
        -errno.ETIMEDOUT,
        device.IcapErrors.TIMEOUT,
        part.reply_length,
    )
    assert part.judge(reply) == ()
    again, reply = reads(part.request, part.reply_length, part.closing)
    assert again.ok
    assert part.judge(reply) == ()


@pytest.mark.parametrize(
    "parts",
    [
        (slice(0, 64), slice(60, 124), slice(128, 192)),
        (slice(0, 64), slice(64, 128), slice(124, 188)),
        (slice(0, 64), slice(64, 128), slice(32, 40)),
        (slice(0, 64), slice(64, 64), slice(128, 192)),
        (slice(0, 64), slice(64, 128), slice(128, 128)),
        (slice(0, 0), slice(64, 128), slice(128, 192)),
        (slice(2, 66), slice(68, 128), slice(128, 192)),
        (slice(0, 64), slice(64, 126), slice(128, 192)),
        (slice(0, 64), slice(64, 1 << 20), slice(1 << 20, (1 << 20) + 64)),
    ],
)
def test_parts_of_a_read_that_are_not_right_are_refused(
    icap: device.Icap, reads: Reads, parts: tuple[slice, slice, slice]
) -> None:
    with icap.allocate(4096) as buffer, pytest.raises(device.DeviceInvalid):
        icap.read(buffer, *parts)


def test_nothing_is_read_while_a_load_runs(
    icap: device.Icap, words: bytes, reads: Reads, slices: list[Slice], board: Board
) -> None:
    with icap.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        stall = board.stall or (lambda on: None)
        stall(True)
        icap.load(buffer, len(words))
        with pytest.raises(device.DeviceBusy):
            icap.read(buffer, slice(0, 4), slice(4, 8), slice(8, 12))
        stall(False)
        assert icap.wait(PATIENCE).ok
