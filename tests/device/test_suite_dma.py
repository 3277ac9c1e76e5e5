# SPDX-License-Identifier: Apache-2.0
"""DMA channels: what is sent comes back, with the length that moved, in order."""

from __future__ import annotations

import errno
import select

import numpy as np
import pytest
from suite_board import PATIENCE, Board

import cm.device as device

Loop = tuple[device.AxiDma, device.AxiDma]
LENGTHS = [8, 64, 4096, 4104, 307_200, 1 << 20]


def pattern(length: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, length, np.uint8)


def round_trip(loop: Loop, data: np.ndarray, room: int) -> tuple[device.Completion, np.ndarray]:
    """Send ``data``, with ``room`` bytes to receive; the completion and what arrived."""
    out, back = loop
    with out.allocate(len(data)) as source, back.allocate(room) as target:
        source.sync_begin(write=True)
        source.array(0, len(data))[:] = data
        source.sync_end(write=True)
        back.submit(target, length=room, cookie=1)
        out.submit(source, length=len(data), cookie=2)
        sent, received = out.wait(PATIENCE), back.wait(PATIENCE)
        assert (sent.cookie, sent.status, sent.length) == (2, 0, len(data))
        target.sync_begin(write=False)
        arrived = target.array(0, received.length).copy()
        target.sync_end(write=False)
    return received, arrived


@pytest.mark.parametrize("length", LENGTHS)
def test_what_is_sent_comes_back(loop: Loop, length: int) -> None:
    data = pattern(length)
    received, arrived = round_trip(loop, data, length)
    assert (received.cookie, received.status, received.length) == (1, 0, length)
    assert np.array_equal(arrived, data)


@pytest.mark.parametrize("length", LENGTHS[:-1])
def test_a_short_packet_reports_the_bytes_that_arrived(loop: Loop, length: int) -> None:
    if device.DmaCaps.RESIDUE not in loop[1].info.caps:
        pytest.skip("the channel does not report short packets")
    data = pattern(length, 1)
    received, arrived = round_trip(loop, data, length + 4096)
    assert (received.status, received.length) == (0, length)
    assert np.array_equal(arrived, data)


def test_transfers_complete_in_order(loop: Loop) -> None:
    out, back = loop
    count, length = min(4, out.info.queue_depth, back.info.queue_depth), 1024
    with out.allocate(count * length) as source, back.allocate(count * length) as target:
        source.array(0, count * length)[:] = data = pattern(count * length, 2)
        for index in range(count):
            back.submit(target, index * length, length, cookie=100 + index)
        for index in range(count):
            out.submit(source, index * length, length, cookie=200 + index)
        received = [back.wait(PATIENCE) for _ in range(count)]
        sent = [out.wait(PATIENCE) for _ in range(count)]
        assert [done.cookie for done in received] == [100 + index for index in range(count)]
        assert [done.cookie for done in sent] == [200 + index for index in range(count)]
        assert [done.sequence for done in received] == list(range(count))
        times = [done.timestamp_ns for done in received]
        assert times == sorted(times)
        assert np.array_equal(target.array(0, count * length), data)


def test_nothing_waits_before_something_ended(loop: Loop) -> None:
    _, back = loop
    assert back.completions() == []
    with pytest.raises(device.DeviceTimeout):
        back.wait(0.01)


def test_a_cancelled_transfer_has_a_completion(loop: Loop) -> None:
    _, back = loop
    with back.allocate(64) as target:
        back.submit(target, cookie=7)
        back.submit(target, cookie=8)
        back.cancel()
        done = back.completions()
        assert [(one.cookie, one.status) for one in done] == [(7, -errno.ECANCELED), (8, -errno.ECANCELED)]
    assert back.completions() == []


def test_a_channel_works_after_a_cancel(loop: Loop) -> None:
    _, back = loop
    with back.allocate(64) as target:
        back.submit(target)
        back.cancel()
        back.completions()
    received, _ = round_trip(loop, pattern(64), 64)
    assert received.status == 0


def test_a_buffer_in_flight_is_not_freed(loop: Loop) -> None:
    _, back = loop
    target = back.allocate(64)
    back.submit(target)
    with pytest.raises(device.DeviceBusy):
        target.close()
    back.cancel()
    target.close()


def test_a_full_queue_is_busy(loop: Loop) -> None:
    _, back = loop
    with back.allocate(64) as target:
        for _ in range(back.info.queue_depth):
            back.submit(target, length=64)
        with pytest.raises(device.DeviceBusy):
            back.submit(target, length=64)
        back.cancel()


def test_a_channel_is_claimed_by_one_file(loop: Loop, board: Board) -> None:
    out, _ = loop
    name, root = board.to_pl or "", board.root
    with pytest.raises(device.DeviceBusy) as caught:
        device.AxiDma.open(name, root)
    assert caught.value.errno == errno.EBUSY
    out.close()
    device.AxiDma.open(name, root).close()


@pytest.mark.parametrize(("offset", "length"), [(0, 1 << 30), (4096, 4096), (1 << 40, 8), (0, 0)])
def test_a_range_outside_of_the_buffer_is_refused(loop: Loop, offset: int, length: int) -> None:
    _, back = loop
    with back.allocate(4096) as target, pytest.raises(device.DeviceInvalid):
        back.submit(target, offset, length)


def test_a_freed_buffer_is_unknown(loop: Loop) -> None:
    _, back = loop
    target = back.allocate(4096)
    target.close()
    with pytest.raises(device.DeviceNotFound):
        back.submit(target, length=64)


def test_a_buffer_of_one_channel_serves_another(loop: Loop) -> None:
    out, back = loop
    data = pattern(4096, 3)
    with out.allocate(8192) as ours, back.import_buffer(ours.fd) as theirs:
        assert theirs.length == ours.length
        ours.array(0, 4096)[:] = data
        back.submit(theirs, 4096, 4096)
        out.submit(ours, 0, 4096)
        assert (out.wait(PATIENCE).status, back.wait(PATIENCE).length) == (0, 4096)
        assert np.array_equal(ours.array(4096, 4096), data)


def test_the_descriptor_polls_readable_when_a_completion_waits(loop: Loop) -> None:
    out, back = loop
    poll = select.poll()
    poll.register(back, select.POLLIN)
    assert poll.poll(0) == []
    with out.allocate(64) as source, back.allocate(64) as target:
        back.submit(target, length=64)
        out.submit(source, length=64)
        assert poll.poll(PATIENCE * 1000) == [(back.fileno(), select.POLLIN)]
        assert len(back.completions()) == 1
        assert poll.poll(0) == []
        out.wait(PATIENCE)
