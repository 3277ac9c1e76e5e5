# SPDX-License-Identifier: Apache-2.0
"""How C functions are called: -1 or NULL plus errno becomes OSError, seconds become nanoseconds."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from typing import Any

from cm.device.native._cm import ffi, lib

FOREVER = int(lib.CM_WAIT_FOREVER)

# A pointer to a C object; what it points to is known to cm.device.native only.
Handle = Any


def last_error(path: str | None = None) -> OSError:
    """Return the OSError (the builtin subclass that fits) for the errno of the last C call."""
    number = ffi.errno
    return OSError(number, os.strerror(number), path) if path else OSError(number, os.strerror(number))


def check(result: int) -> int:
    """Return ``result``, or raise OSError if it is negative."""
    if result < 0:
        raise last_error()
    return result


def owned(pointer: Handle, close: Callable[[Handle], None], path: str) -> Handle:
    """Return ``pointer`` so that ``close`` frees it with its last reference; OSError if it is NULL."""
    if pointer == ffi.NULL:
        raise last_error(path)
    return ffi.gc(pointer, close)


def wait(call: Callable[[int], int], timeout: float | None) -> None:
    """Call ``call(nanoseconds left)``, again after each signal so that its Python handler runs.

    ``timeout`` is in seconds, None waits without end.  Raises TimeoutError (ETIMEDOUT) and OSError.
    """
    deadline = None if timeout is None else time.monotonic_ns() + int(min(timeout, 1e9) * 1e9)
    while True:
        left = FOREVER if deadline is None else max(deadline - time.monotonic_ns(), 0)
        if call(left) >= 0:
            return
        if ffi.errno != errno.EINTR:
            raise last_error()


def encode(path: str) -> bytes:
    """Return ``path`` as the file system has it; a NUL inside is ValueError."""
    data = os.fsencode(path)
    if b"\0" in data:
        raise ValueError(f"path holds a NUL byte: {path!r}")
    return data
