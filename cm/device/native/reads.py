# SPDX-License-Identifier: Apache-2.0
"""Registers that local clients read by name: a table, and the C thread that answers."""

from __future__ import annotations

from typing import NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, last_error


class Read(NamedTuple):
    """``struct cm_read``."""

    uio: Handle
    map: int
    width: int
    offset: int
    mask: int
    lsb: int


def new() -> Handle:
    """Start the thread; `close` ends it."""
    reads = lib.cm_reads_new()
    if reads == ffi.NULL:
        raise last_error()
    return reads


def close(reads: Handle) -> None:
    """End the thread and free everything; nothing may use ``reads`` any more."""
    lib.cm_reads_close(reads)


def wanted_fd(reads: Handle) -> int:
    """Return the eventfd that polls readable when the table lacks something."""
    return int(lib.cm_reads_wanted_fd(reads))


def adopt(reads: Handle, fd: int, owner: int) -> None:
    """Take over a connected socket of the process ``owner``."""
    check(lib.cm_reads_adopt(reads, fd, owner))


def offer(reads: Handle, name: str, read: Read) -> None:
    """Put a name into the table."""
    check(lib.cm_reads_offer(reads, name.encode(), ffi.new("struct cm_read *", read)))


def withdraw(reads: Handle) -> None:
    """Empty the table, and wait for the end of a read under way."""
    lib.cm_reads_withdraw(reads)


def loads(uio: Handle, index: int) -> bool:
    """Whether a window of a UIO device is read by loads."""
    return bool(lib.cm_uio_loads(uio, index))
