# SPDX-License-Identifier: Apache-2.0
"""A window's memory, in a form that clients can map: ``struct cm_node_mirror`` of ``cm_node.h``.

A client reads a register there by a load instruction, as it does on a real board. If that would differ from the bus's
answer, a flag beside the byte sends the client to the bus.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os

from cm.sim.errors import NodeError

_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW


class Mirror:
    """Values of a window, and for each byte whether the bus has to be asked for it.

    Pages are allocated when they are written, since a window may be large and hold two registers.
    """

    def __init__(self, name: str, size: int) -> None:
        self.size = -(-max(size, 1) // mmap.PAGESIZE) * mmap.PAGESIZE
        self._fd = os.memfd_create(f"cm-{name}", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(self._fd, 2 * self.size)
        fcntl.fcntl(self._fd, fcntl.F_ADD_SEALS, _SEALS)  # a client that maps it may rely on its length
        self.values = mmap.mmap(self._fd, self.size)
        self._flags = mmap.mmap(self._fd, self.size, offset=self.size)

    def ask(self, offset: int, length: int, ask: bool) -> None:
        """Set whether the bus has to be asked for some bytes."""
        self._flags[offset : offset + length] = (b"\1" if ask else b"\0") * length

    def clear(self) -> None:
        """All values zero again."""
        self.values.madvise(mmap.MADV_REMOVE)

    def descriptor(self) -> int:
        """A descriptor to pass on, the caller's. Raises NodeError if there are no more."""
        try:
            return os.dup(self._fd)
        except OSError as error:
            raise NodeError(error.errno or errno.EMFILE) from error

    def __del__(self) -> None:
        os.close(self._fd)
