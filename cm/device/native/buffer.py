# SPDX-License-Identifier: Apache-2.0
"""Memory of DMA buffers, as C sees it."""

from __future__ import annotations

from typing import Any

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, last_error


def new() -> Handle:
    """Return an empty ``struct cm_buffer`` that closes its descriptor with its last reference."""
    return ffi.gc(ffi.new("struct cm_buffer *", {"fd": -1}), lib.cm_buffer_close)


def fields(buffer: Handle) -> tuple[int, int, bool, int, int]:
    """Return (fd, handle, coherent, length, address)."""
    return buffer.fd, buffer.handle, bool(buffer.coherent), buffer.length, buffer.address


def map_memory(buffer: Handle, writable: bool) -> Any:
    """Map the whole buffer; the result has the buffer protocol (``memoryview(result)``).

    The memory is unmapped when nothing refers to it any more: every view holds a reference.
    """
    pointer = lib.cm_buffer_map(buffer, writable)
    if pointer == ffi.NULL:
        raise last_error()
    length = buffer.length

    def unmap(memory: Handle) -> None:
        lib.cm_buffer_unmap(memory, length)

    return ffi.buffer(ffi.gc(pointer, unmap, length), length)


def sync(buffer: Handle, begin: bool, write: bool) -> None:
    """Begin or end CPU access (DMA_BUF_IOCTL_SYNC); nothing where the memory is coherent."""
    check(lib.cm_buffer_sync(buffer, begin, write))


def close(buffer: Handle) -> None:
    """Close the descriptor; mappings stay.  Twice is fine."""
    lib.cm_buffer_close(buffer)
