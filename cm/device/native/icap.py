# SPDX-License-Identifier: Apache-2.0
"""Configuration ports: structs become named tuples, errno becomes OSError."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

from cm.device.native import buffer as native_buffer
from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, encode, last_error, owned, wait

CAP_STATUS: int = lib.CM_ICAP_CAP_STATUS
CAP_DENIED: int = lib.CM_ICAP_CAP_DENIED
CAP_READ: int = lib.CM_ICAP_CAP_READ
LOAD_FULL: int = lib.CM_ICAP_LOAD_FULL
LOAD_ENCRYPTED: int = lib.CM_ICAP_LOAD_ENCRYPTED
STATE_IDLE: int = lib.CM_ICAP_STATE_IDLE
STATE_LOADING: int = lib.CM_ICAP_STATE_LOADING
STATE_ERROR: int = lib.CM_ICAP_STATE_ERROR
ERR_CRC: int = lib.CM_ICAP_ERR_CRC
ERR_ID: int = lib.CM_ICAP_ERR_ID
ERR_DMA: int = lib.CM_ICAP_ERR_DMA
ERR_TIMEOUT: int = lib.CM_ICAP_ERR_TIMEOUT
ERR_NOSYNC: int = lib.CM_ICAP_ERR_NOSYNC
ERR_PORT: int = lib.CM_ICAP_ERR_PORT


class Info(NamedTuple):
    """``struct cm_icap_info``."""

    word_bits: int
    clock_hz: int
    max_length: int
    idcode: int
    caps: int


class Status(NamedTuple):
    """``struct cm_icap_status``."""

    state: int
    errors: int
    bytes_done: int
    bytes_total: int
    loads: int


class Completion(NamedTuple):
    """``struct cm_icap_completion``."""

    cookie: int
    length: int
    started_ns: int
    finished_ns: int
    status: int
    errors: int


# ``struct cm_icap_parts``: offset and length, in bytes, of request, reply and closing in a read's buffer
Parts: TypeAlias = tuple[int, int, int, int, int, int]


def _completion(c: Handle) -> Completion:
    return Completion(c.cookie, c.length, c.started_ns, c.finished_ns, c.status, c.errors)


def open_port(root: str, name: str) -> Handle:
    """Open the port /dev/``name``."""
    return owned(lib.cm_icap_open(encode(root), encode(name)), lib.cm_icap_close, f"{root}/dev/{name}")


def release(handle: Handle) -> None:
    """Close the port after the end of its load; later calls raise OSError with EBADF."""
    lib.cm_icap_release(handle)


def event_fd(handle: Handle) -> int:
    """Return the descriptor that polls readable when a load has ended."""
    return check(lib.cm_icap_event_fd(handle))


def info(handle: Handle) -> Info:
    """Return what the port is."""
    i = ffi.new("struct cm_icap_info *")
    check(lib.cm_icap_get_info(handle, i))
    return Info(i.word_bits, i.clock_hz, i.max_length, i.idcode, i.caps)


def status(handle: Handle) -> Status:
    """Return what the port does now."""
    s = ffi.new("struct cm_icap_status *")
    check(lib.cm_icap_get_status(handle, s))
    return Status(s.state, s.errors, s.bytes_done, s.bytes_total, s.loads)


def alloc(handle: Handle, length: int) -> Handle:
    """Allocate a buffer: a ``struct cm_buffer``, see `cm.device.native.buffer`."""
    buffer = native_buffer.new()
    check(lib.cm_icap_alloc(handle, length, buffer))
    return buffer


def import_fd(handle: Handle, fd: int) -> Handle:
    """Attach foreign memory; the descriptor stays the caller's."""
    buffer = native_buffer.new()
    check(lib.cm_icap_import(handle, fd, buffer))
    return buffer


def free(handle: Handle, buffer_handle: int) -> None:
    """Give a buffer's handle back; EBUSY while a load uses it."""
    check(lib.cm_icap_free(handle, buffer_handle))


def load(handle: Handle, buffer: int, offset: int, length: int, cookie: int, flags: int) -> None:
    """Start a load and return at once."""
    if lib.cm_icap_load(handle, buffer, offset, length, cookie, flags) < 0:
        raise last_error()


def read_back(handle: Handle, buffer: int, parts: Parts, cookie: int) -> None:
    """Start a read and return at once."""
    if lib.cm_icap_read_back(handle, buffer, ffi.new("struct cm_icap_parts *", parts), cookie) < 0:
        raise last_error()


def take(handle: Handle) -> Completion | None:
    """Return the end of a load if it came, else None."""
    completion = ffi.new("struct cm_icap_completion *")
    return _completion(completion) if check(lib.cm_icap_take(handle, completion)) else None


def wait_completion(handle: Handle, timeout: float | None) -> Completion:
    """Wait for the end of a load and take it; TimeoutError."""
    completion = ffi.new("struct cm_icap_completion *")
    wait(lambda left: lib.cm_icap_wait(handle, left, completion), timeout)
    return _completion(completion)
