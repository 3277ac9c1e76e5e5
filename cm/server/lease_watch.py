# SPDX-License-Identifier: Apache-2.0
"""Ends leases: with the process that holds them, and when their time is over, whether somebody asks or not."""

from __future__ import annotations

import errno
import logging
import os
from functools import partial
from typing import NoReturn

from cm.errors import Busy
from cm.loop import Timer
from cm.manager.access.leases import Leases
from cm.server.sockets import Loop
from cm.wire.messages.requests import BreakLease, ReleaseLease, RenewLease, TakeLease
from cm.wire.messages.status import LeaseInfo

_LOG = logging.getLogger("cm")
_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)


class Unwatched(Busy):
    """There are no descriptors to watch the holder of a lease with."""

    code = "lease_unwatched"


class LeaseWatch:
    """One pidfd for each lease that names a process of this machine."""

    def __init__(self, loop: Loop, leases: Leases) -> None:
        self._loop = loop
        self._leases = leases
        self._fds: dict[str, int] = {}
        self._timer: Timer | None = None

    def follow(
        self, lease: LeaseInfo, request: TakeLease | RenewLease | ReleaseLease | BreakLease, client: str = ""
    ) -> None:
        """Follow a granted, renewed or returned lease. Raises Unwatched, and the lease has ended then."""
        self._await_next_end()
        if isinstance(request, BreakLease):
            _LOG.warning("lease %d on %s, of %s, was broken by %s", request.number, lease.scope, lease.holder, client)
        elif not isinstance(request, RenewLease):
            done = "taken" if isinstance(request, TakeLease) else "given back"
            _LOG.info("lease on %s %s by %s for %s", lease.scope, done, client, lease.holder)
        if isinstance(request, (TakeLease, RenewLease)) and request.pid and lease.id not in self._fds:
            self._watch_holder(lease.id, request.pid)

    def _await_next_end(self) -> None:
        """Be there when the next lease's time is over: nobody may ask, and subscribers are told all the same."""
        if self._timer is not None:
            self._timer.cancel()
        left = self._leases.expire()
        self._timer = None if left is None else self._loop.call_later(left, self._await_next_end)
        for lease in [lease for lease in self._fds if not self._leases.holds(lease)]:  # given back, or over
            self._close(lease)

    def _watch_holder(self, lease: str, pid: int) -> None:
        try:
            fd = os.pidfd_open(pid)
        except ProcessLookupError:
            self._leases.drop(lease)
            return
        except OSError as error:
            if error.errno in _EXHAUSTED:
                self._refuse(lease, error)
            return  # no such call (Linux before 5.3), or not permitted: the time-out ends the lease
        try:
            self._loop.add(fd, partial(self._drop_dead, lease))
        except OSError as error:
            os.close(fd)
            self._refuse(lease, error)
        self._fds[lease] = fd

    def _refuse(self, lease: str, error: OSError) -> NoReturn:
        """Refuse it: the holder's death would go unnoticed, so it could keep others out until its time is over."""
        self._leases.drop(lease)
        raise Unwatched(f"no lease now: its holder cannot be watched ({error.strerror})") from error

    def _drop_dead(self, lease: str) -> None:
        """Its holder has died."""
        self._leases.drop(lease)
        self._await_next_end()

    def _close(self, lease: str) -> None:
        fd = self._fds.pop(lease)
        self._loop.remove(fd)
        os.close(fd)

    def close(self) -> None:
        """Stop watching."""
        if self._timer is not None:
            self._timer.cancel()
        for lease in list(self._fds):
            self._close(lease)
