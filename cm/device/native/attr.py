# SPDX-License-Identifier: Apache-2.0
"""Attributes of sysfs and configfs, plain or simulated."""

from __future__ import annotations

from cm.device.native._cm import ffi, lib
from cm.device.native.call import check, encode

READ_MAX = 1 << 16
_room = ffi.new_allocator(should_clear_after_alloc=False)


def read(root: str, path: str) -> bytes:
    """Return the attribute's bytes (at most 64 KiB)."""
    data = _room("char[]", READ_MAX)
    count = check(lib.cm_attr_read(encode(root), encode(path), data, READ_MAX))
    return bytes(ffi.buffer(data, count))


def write(root: str, path: str, data: bytes) -> None:
    """Write all of ``data`` in one go."""
    check(lib.cm_attr_write(encode(root), encode(path), ffi.from_buffer(data), len(data)))


def mkdir(root: str, folder: str, name: str) -> None:
    """Make the folder ``name`` in ``folder``."""
    check(lib.cm_attr_mkdir(encode(root), encode(folder), encode(name)))


def rmdir(root: str, folder: str, name: str) -> None:
    """Remove the folder ``name`` from ``folder``."""
    check(lib.cm_attr_rmdir(encode(root), encode(folder), encode(name)))


def watch(root: str, folder: str) -> int:
    """A non-blocking descriptor of inotify(7), the caller's: an event for each attribute in it that is written."""
    return check(lib.cm_attr_watch(encode(root), encode(folder)))
