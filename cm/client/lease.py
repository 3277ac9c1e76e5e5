# SPDX-License-Identifier: Apache-2.0
"""A lease as a context manager."""

from __future__ import annotations

import os
from collections.abc import Callable
from types import TracebackType

from cm.client import calls
from cm.client.calls import Call
from cm.messages.requests import ReleaseLease, RenewLease, TakeLease
from cm.messages.status import LeaseInfo


class BoardLease:
    """Held from entering to leaving, or until its time is over; `renew()` begins its time anew.

    `id` goes into the ``lease=`` of calls. It also ends when this process dies (on the manager's machine).
    """

    def __init__(
        self,
        ask: Callable[[Call[LeaseInfo]], LeaseInfo],
        scope: str,
        exclusive: bool,
        seconds: float,
        holder: str,
        local: bool,
    ) -> None:
        self._ask = ask
        pid = os.getpid() if local else 0  # a number of another machine would name somebody else here
        self._wanted = TakeLease(scope, exclusive, seconds, holder=holder, pid=pid)
        self.id = ""

    def take(self) -> str:
        """Take it; returns its id. Raises RequestBusy with who holds it."""
        self.id = self._ask(calls.lease(self._wanted)).id
        return self.id

    def renew(self) -> None:
        """Begin its time anew. Raises RequestNotFound if it has ended."""
        self._ask(calls.lease(RenewLease(self.id, self._wanted.seconds)))

    def release(self) -> None:
        """Give it back; twice is fine."""
        if self.id:
            held, self.id = self.id, ""
            self._ask(calls.lease(ReleaseLease(held)))

    def __enter__(self) -> BoardLease:
        self.take()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.release()
