# SPDX-License-Identifier: Apache-2.0
"""Register pages on loan: lent, used by load and store, taken back at once."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections.abc import Iterator

import pytest
from suite_board import PATIENCE, Board

from cm import device

PAGE = os.sysconf("SC_PAGE_SIZE")


@pytest.fixture
def place(board: Board) -> tuple[int, int]:
    """Address of a page that can be lent, and the offset of a register in it that holds what is written."""
    if board.lend is None:
        pytest.skip("the board has no window that can be lent")
    return board.lend


@pytest.fixture
def windows(board: Board, place: tuple[int, int]) -> Iterator[device.Windows]:
    with device.Windows.open(board.root) as opened:
        yield opened


@pytest.fixture
def owner(board: Board, place: tuple[int, int]) -> Iterator[device.Uio]:
    """The same registers as their owner sees them."""
    with device.Uio.open(place[0], board.root) as opened:
        yield opened


def mapped(grant: device.Grant) -> device.MappedWindow:
    """What a client has of it: its own mapping, and no descriptor."""
    with grant:
        return device.MappedWindow(grant.fd)


def read_until(ends: float, window: device.MappedWindow, offset: int) -> None:
    """Read on: a simulated node hears a moment later that a window's owner is gone."""
    while time.monotonic() < ends:
        window.read(offset)


def events(windows: device.Windows) -> list[device.WindowEvent]:
    assert select.select([windows], [], [], PATIENCE)[0]
    return windows.take()


def test_a_window_reads_and_writes_the_registers_of_its_owner(
    windows: device.Windows, owner: device.Uio, place: tuple[int, int]
) -> None:
    address, offset = place
    with mapped(windows.grant(address, PAGE, write=True)) as window:
        assert (window.size, window.writable, window.revoked) == (PAGE, True, None)
        window.write(offset, 0x5)
        assert owner.read(offset) == 0x5
        owner.write(offset, 0x3)
        assert window.read(offset) == 0x3
        assert int.from_bytes(window.read_block(offset, 4), "little") == 0x3
        window.write_block(offset, (7).to_bytes(4, "little"))
        assert owner.read(offset) == 7


def test_a_window_for_reading_refuses_a_write(windows: device.Windows, place: tuple[int, int]) -> None:
    address, offset = place
    with mapped(windows.grant(address, PAGE)) as window:
        window.read(offset)
        with pytest.raises(device.DevicePermission):
            window.write(offset, 1)


@pytest.mark.parametrize(("offset", "width"), [(PAGE, 32), (PAGE - 2, 32), (2, 32), (0, 24), (1 << 60, 8)])
def test_an_access_outside_of_it_is_refused(
    windows: device.Windows, place: tuple[int, int], offset: int, width: int
) -> None:
    with (
        mapped(windows.grant(place[0], PAGE, write=True)) as window,
        pytest.raises(device.DeviceInvalid),
    ):
        window.read(offset, width)


def test_what_was_taken_back_is_not_the_registers_any_more(
    windows: device.Windows, owner: device.Uio, place: tuple[int, int]
) -> None:
    address, offset = place
    with mapped(windows.grant(address, PAGE, write=True)) as window:
        window.write(offset, 1)
        assert windows.revoke(address, PAGE) == 1
        for access in (lambda: window.read(offset), lambda: window.write(offset, 2), lambda: window.read_block(0, 8)):
            with pytest.raises(device.DeviceRevoked) as told:
                access()
            assert told.value.reason is device.WindowEnd.CALL
        assert window.revoked is device.WindowEnd.CALL
        assert owner.read(offset) == 1
        assert windows.revoke(address, PAGE) == 0


def test_one_of_several_grants_is_taken_back(windows: device.Windows, place: tuple[int, int]) -> None:
    address, offset = place
    one, other = windows.grant(address, PAGE), windows.grant(address, PAGE)
    with mapped(one) as taken, mapped(other) as kept:
        assert windows.revoke_grant(one.id)
        assert not windows.revoke_grant(one.id)
        assert taken.revoked
        kept.read(offset)


def test_who_lent_is_told_when_nobody_has_it_any_more(windows: device.Windows, place: tuple[int, int]) -> None:
    grant = windows.grant(place[0], PAGE)
    window = mapped(grant)
    assert windows.take() == []
    window.close()
    assert events(windows) == [device.WindowEvent(grant.id, device.WindowEnd.RELEASED)]
    with pytest.raises(device.DeviceNotFound):
        windows.revoke_grant(grant.id)


def test_what_was_given_back_is_closed(windows: device.Windows, place: tuple[int, int]) -> None:
    window = mapped(windows.grant(place[0], PAGE, write=True))
    window.close()
    window.close()
    for access in (lambda: window.read(0), lambda: window.write(0, 1), lambda: window.revoked):
        with pytest.raises(device.DeviceClosed):
            access()


def test_grants_end_with_who_lent_them(board: Board, place: tuple[int, int]) -> None:
    address, offset = place
    with device.Windows.open(board.root) as windows:
        window = mapped(windows.grant(address, PAGE))
        window.read(offset)
    with window, pytest.raises(device.DeviceRevoked) as told:
        read_until(time.monotonic() + PATIENCE, window, offset)
    assert told.value.reason is device.WindowEnd.OWNER


def test_a_descriptor_is_given_away(windows: device.Windows, place: tuple[int, int]) -> None:
    address, offset = place
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        with windows.grant(address, PAGE, write=True) as grant:
            socket.send_fds(ours, [b"x"], [grant.fd])
        (fd,) = socket.recv_fds(theirs, 1, 1)[1]
    with device.MappedWindow(fd) as window:
        os.close(fd)
        window.write(offset, 2)
        assert window.read(offset) == 2


@pytest.mark.parametrize(
    ("shift", "length", "kind"),
    [(16, PAGE, device.DeviceInvalid), (0, 16, device.DeviceInvalid), (0, 0, device.DeviceInvalid)],
)
def test_whole_pages_are_lent(
    windows: device.Windows, place: tuple[int, int], shift: int, length: int, kind: type[device.DeviceError]
) -> None:
    with pytest.raises(kind):
        windows.grant(place[0] + shift, length)


def test_a_range_that_no_window_has_is_not_lent(windows: device.Windows, place: tuple[int, int]) -> None:
    with pytest.raises(device.DeviceGone) as told:
        windows.grant(place[0], 1 << 30)
    assert told.value.errno == errno.ENXIO


def test_what_is_no_grant_cannot_be_mapped() -> None:
    read, write = os.pipe()
    try:
        with pytest.raises(device.DeviceError):
            device.MappedWindow(read)
    finally:
        os.close(read)
        os.close(write)
