# SPDX-License-Identifier: Apache-2.0
"""Watches the processes that hold leases: a lease ends with its holder."""

from __future__ import annotations

import os

from cm.daemon.loop import Loop
from cm.manager.access.leases import Leases
from cm.messages.requests import TakeLease
from cm.messages.status import LeaseInfo


class Holders:
    """One pidfd for each lease that names a process of this machine."""

    def __init__(self, loop: Loop, leases: Leases) -> None:
        self._loop = loop
        self._leases = leases
        self._fds: dict[str, int] = {}

    def watch(self, lease: LeaseInfo, request: TakeLease) -> None:
        """Follow a granted, renewed or returned lease."""
        if request.release:
            self._forget(lease.id)
        elif request.pid and lease.id not in self._fds:
            self._open(lease.id, request.pid)

    def _open(self, lease: str, pid: int) -> None:
        try:
            fd = os.pidfd_open(pid)
        except ProcessLookupError:
            self._leases.drop(lease)
            return
        except OSError:  # no such call (Linux before 5.3), or not ours to see: the time-out ends the lease
            return
        self._fds[lease] = fd
        self._loop.add(fd, lambda: self._died(lease))

    def _died(self, lease: str) -> None:
        self._leases.drop(lease)
        self._forget(lease)

    def _forget(self, lease: str) -> None:
        fd = self._fds.pop(lease, None)
        if fd is not None:
            self._loop.remove(fd)
            os.close(fd)

    def close(self) -> None:
        """Stop watching."""
        for lease in list(self._fds):
            self._forget(lease)
