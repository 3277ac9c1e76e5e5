# SPDX-License-Identifier: Apache-2.0
"""DMA channels: structs become named tuples, errno becomes OSError."""

from __future__ import annotations

from typing import NamedTuple

from cm.device.native import buffer as native_buffer
from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, encode, last_error, owned, wait

MM2S: int = lib.CM_DMA_MM2S
S2MM: int = lib.CM_DMA_S2MM
TYPE_AXIDMA: int = lib.CM_DMA_TYPE_AXIDMA
TYPE_VDMA: int = lib.CM_DMA_TYPE_VDMA
CAP_CYCLIC: int = lib.CM_DMA_CAP_CYCLIC
CAP_VIDEO: int = lib.CM_DMA_CAP_VIDEO
CAP_RESIDUE: int = lib.CM_DMA_CAP_RESIDUE
CAP_SIMPLE: int = lib.CM_DMA_CAP_SIMPLE
SUBMIT_CYCLIC: int = lib.CM_DMA_SUBMIT_CYCLIC
OVERRUN: int = lib.CM_DMA_COMPLETION_OVERRUN

TAKE_AT_ONCE = 64


class Info(NamedTuple):
    """``struct cm_dma_info``."""

    direction: int
    type: int
    caps: int
    queue_depth: int
    max_length: int
    alignment: int
    frame_length: int
    name: str


class Completion(NamedTuple):
    """``struct cm_dma_completion``."""

    cookie: int
    length: int
    timestamp_ns: int
    sequence: int
    status: int
    flags: int


def _completion(c: Handle) -> Completion:
    return Completion(c.cookie, c.length, c.timestamp_ns, c.sequence, c.status, c.flags)


def open_channel(root: str, name: str) -> Handle:
    """Claim the channel ``name``; EBUSY while another file holds it."""
    return owned(lib.cm_dma_open(encode(root), encode(name)), lib.cm_dma_close, f"{root}/dev/cm_dma/{name}")


def release(handle: Handle) -> None:
    """Close the channel; later calls raise OSError with EBADF."""
    lib.cm_dma_release(handle)


def event_fd(handle: Handle) -> int:
    """Return the descriptor that polls readable when a completion waits."""
    return check(lib.cm_dma_event_fd(handle))


def info(handle: Handle) -> Info:
    """Return what the channel is."""
    i = ffi.new("struct cm_dma_info *")
    check(lib.cm_dma_get_info(handle, i))
    name = bytes(ffi.buffer(i.name)).split(b"\0", 1)[0].decode("utf-8", "replace")
    return Info(i.direction, i.type, i.caps, i.queue_depth, i.max_length, i.alignment, i.frame_length, name)


def alloc(handle: Handle, length: int) -> Handle:
    """Allocate a buffer: a ``struct cm_buffer``, see `cm.device.native.buffer`."""
    buffer = native_buffer.new()
    check(lib.cm_dma_alloc(handle, length, buffer))
    return buffer


def import_fd(handle: Handle, fd: int) -> Handle:
    """Attach foreign memory; the descriptor stays the caller's."""
    buffer = native_buffer.new()
    check(lib.cm_dma_import(handle, fd, buffer))
    return buffer


def free(handle: Handle, buffer_handle: int) -> None:
    """Give a buffer's handle back; EBUSY while a transfer uses it."""
    check(lib.cm_dma_free(handle, buffer_handle))


def submit(handle: Handle, buffer: int, offset: int, length: int, cookie: int, flags: int, period: int) -> None:
    """Queue a transfer."""
    if lib.cm_dma_submit(handle, buffer, offset, length, cookie, flags, period) < 0:
        raise last_error()


def submit_video(
    handle: Handle, buffer: int, offset: int, lines: int, line_bytes: int, stride: int, cookie: int, flags: int
) -> None:
    """Queue a video frame."""
    if lib.cm_dma_submit_video(handle, buffer, offset, lines, line_bytes, stride, cookie, flags) < 0:
        raise last_error()


def cancel(handle: Handle) -> None:
    """End all transfers; returns when the hardware has stopped."""
    check(lib.cm_dma_cancel(handle))


def take(handle: Handle) -> list[Completion]:
    """Return all completions that are there, at most ``TAKE_AT_ONCE``."""
    array = ffi.new("struct cm_dma_completion[]", TAKE_AT_ONCE)
    count = check(lib.cm_dma_take(handle, array, TAKE_AT_ONCE))
    return [_completion(array[index]) for index in range(count)]


def wait_completion(handle: Handle, timeout: float | None) -> Completion:
    """Wait for the next completion and take it; TimeoutError."""
    completion = ffi.new("struct cm_dma_completion *")
    wait(lambda left: lib.cm_dma_wait(handle, left, completion), timeout)
    return _completion(completion)
