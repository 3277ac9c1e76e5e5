# SPDX-License-Identifier: Apache-2.0
"""Register pages on loan (cm_window.h): structs become named tuples, errno becomes OSError."""

from __future__ import annotations

from typing import Any, NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, encode, last_error, owned

WRITE: int = lib.CM_WINDOW_WRITE
RELEASED: int = lib.CM_WINDOW_RELEASED
REVOKED_CALL: int = lib.CM_WINDOW_REVOKED_CALL
REVOKED_BRIDGE: int = lib.CM_WINDOW_REVOKED_BRIDGE
REVOKED_OWNER: int = lib.CM_WINDOW_REVOKED_OWNER
REVOKED_GONE: int = lib.CM_WINDOW_REVOKED_GONE
REVOKED_SLEEP: int = lib.CM_WINDOW_REVOKED_SLEEP

TAKE_AT_ONCE = 64

read32 = lib.cm_grant_read32  # the value, or -1: see `cm.device.native.call.last_error`
write_plain = lib.cm_grant_write  # handle, offset, width, value; 0, or -1


class Event(NamedTuple):
    """``struct cm_window_event``."""

    id: int
    reason: int


def open_node(root: str) -> Handle:
    """Open the node; the grants made with it end with it."""
    return owned(lib.cm_windows_open(encode(root)), lib.cm_windows_close, f"{root}/dev/cm_window")


def release(handle: Handle) -> None:
    """Close the node; later calls raise OSError with EBADF."""
    lib.cm_windows_release(handle)


def event_fd(handle: Handle) -> int:
    """Return the descriptor that polls readable when an event waits."""
    return check(lib.cm_windows_event_fd(handle))


def grant(handle: Handle, address: int, length: int, flags: int) -> tuple[int, int]:
    """Lend pages; returns the grant's number, and a descriptor, the caller's."""
    number = ffi.new("uint32_t *")
    fd = check(lib.cm_windows_grant(handle, address, length, flags, number))
    return number[0], fd


def revoke(handle: Handle, address: int, length: int) -> int:
    """Take a range back; returns from how many."""
    return check(lib.cm_windows_revoke(handle, address, length))


def revoke_one(handle: Handle, number: int) -> int:
    """Take one grant back; 1, or 0 where it had been."""
    return check(lib.cm_windows_revoke_one(handle, number))


def take(handle: Handle) -> list[Event]:
    """Take the events that are there, at most 64."""
    events = ffi.new("struct cm_window_event[]", TAKE_AT_ONCE)
    count = check(lib.cm_windows_take(handle, events, TAKE_AT_ONCE))
    return [Event(events[index].id, events[index].reason) for index in range(count)]


def map_grant(fd: int) -> Handle:
    """Map what a grant's descriptor stands for, which stays the caller's."""
    return owned(lib.cm_grant_map(fd), lib.cm_grant_unmap, "a window's descriptor")


def unmap(handle: Handle) -> None:
    """Give the pages back; later calls raise OSError with EBADF."""
    lib.cm_grant_release(handle)


def shape(handle: Handle) -> tuple[int, bool]:
    """Bytes of the registers, and whether they may be written."""
    return lib.cm_grant_length(handle), bool(lib.cm_grant_writable(handle))


def revoked(handle: Handle) -> int:
    """0, or why the pages were taken back."""
    return check(lib.cm_grant_revoked(handle))


def read(handle: Handle, offset: int, width: int) -> int:
    """One access; ESTALE once the pages were taken back."""
    value = ffi.new("uint64_t *")
    check(lib.cm_grant_read(handle, offset, width, value))
    return int(value[0])


def write(handle: Handle, offset: int, width: int, value: int) -> None:
    """One access; ESTALE once the pages were taken back."""
    if lib.cm_grant_write(handle, offset, width, value) < 0:
        raise last_error()


def read_block(handle: Handle, offset: int, data: Any) -> None:
    """Fill a writable buffer with words, each one access of 32 bits."""
    with ffi.from_buffer("uint8_t[]", data, require_writable=True) as room:
        check(lib.cm_grant_read_block(handle, offset, room, len(room)))


def write_block(handle: Handle, offset: int, data: Any) -> None:
    """Write a buffer's words, each one access of 32 bits."""
    with ffi.from_buffer("uint8_t[]", data) as words:  # as in `uio`
        check(lib.cm_grant_write_block(handle, offset, words, len(words)))
