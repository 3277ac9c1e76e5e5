# SPDX-License-Identifier: Apache-2.0
"""Descriptors of slots for clients, sealed so that clients can do no more with the memory than read or fill it."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress

from cm.device import DmaBuffer

_F_SEAL_FUTURE_WRITE = 0x0010  # linux/fcntl.h; the module has it from Python 3.13 on


def for_readers(slot: DmaBuffer) -> int:
    """Return a descriptor that readers can neither map writable nor reopen so, if it is a memfd (a simulated board).

    A dma-buf takes no seals and cannot be reopened: see docs/security.md.
    """
    if slot.coherent:  # otherwise it has counters beside its content, which readers write to
        _seal(slot.fd, _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL)
    try:
        return os.open(f"/proc/self/fd/{slot.fd}", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return os.dup(slot.fd)


def for_writers(slot: DmaBuffer) -> int:
    """Return a descriptor for writers, none of whom can seal the memory against the others."""
    _seal(slot.fd, fcntl.F_SEAL_SEAL)
    return os.dup(slot.fd)


def _seal(fd: int, seals: int) -> None:
    with suppress(OSError):  # a dma-buf, or Linux before 5.1
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, seals)
