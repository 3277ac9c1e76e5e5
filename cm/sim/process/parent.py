# SPDX-License-Identifier: Apache-2.0
"""Who owns the simulator: it may end when its owner has died and it has no clients, or find a new owner."""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Callable

from cm.loop import Loop
from cm.sim.errors import NodeError

_CHECK = 0.25


class Parent:
    """The process that the simulator was started by, or taken over by later."""

    def __init__(self) -> None:
        self._pid = os.getppid()
        self._fd = _pidfd(self._pid)

    @property
    def dead(self) -> bool:
        """Whether it has ended, also if it did before we looked."""
        return self._fd < 0 or bool(select.select([self._fd], [], [], 0)[0])

    def replace(self, pid: int) -> None:
        """Belong to another process from now on (EBUSY while the present owner lives, ESRCH)."""
        if not self.dead:
            raise NodeError(errno.EBUSY, f"process {self._pid} owns this simulator")
        fd = _pidfd(pid)
        if fd < 0:
            raise NodeError(errno.ESRCH, f"there is no process {pid}")
        if self._fd >= 0:
            os.close(self._fd)
        self._pid, self._fd = pid, fd


class Linger:
    """Stops the loop when the parent is dead and no client was connected for a while."""

    def __init__(self, loop: Loop, connections: Callable[[], int], parent: Parent, seconds: float) -> None:
        self._loop, self._connections, self._parent = loop, connections, parent
        self._left = self._seconds = seconds

    def check(self) -> None:
        """Look now, and again."""
        idle = self._parent.dead and not self._connections()
        self._left = self._left - _CHECK if idle else self._seconds
        if self._left < 0:
            self._loop.stop()
        else:
            self._loop.call_later(_CHECK, self.check)


def _pidfd(pid: int) -> int:
    try:
        return os.pidfd_open(pid)
    except OSError:
        return -1
