# SPDX-License-Identifier: Apache-2.0
"""Slots as clients get them: what they can do with the memory beside looking at it, or filling it."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress

from cm.device import DmaBuffer

_F_SEAL_FUTURE_WRITE = 0x0010  # linux/fcntl.h; the module has it from Python 3.13 on


def for_readers(slot: DmaBuffer) -> int:
    """The same memory for readers, who then cannot map it writable, nor open it so: a memfd, as a simulated board has.

    A dma-buf takes no seals and cannot be opened anew: docs/security.md.
    """
    if slot.coherent:  # what is not has counters beside its content, which readers write to
        _seal(slot.fd, _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL)
    try:
        return os.open(f"/proc/self/fd/{slot.fd}", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return os.dup(slot.fd)


def for_writers(slot: DmaBuffer) -> int:
    """The same memory for writers, none of whom may seal it against the others."""
    _seal(slot.fd, fcntl.F_SEAL_SEAL)
    return os.dup(slot.fd)


def _seal(fd: int, seals: int) -> None:
    with suppress(OSError):  # of a dma-buf, or before Linux 5.1
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, seals)
