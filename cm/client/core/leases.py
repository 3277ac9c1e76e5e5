# SPDX-License-Identifier: Apache-2.0
"""Leases that this client holds: within a with-block, its own calls pass."""

from __future__ import annotations

import os
from typing import Any, TypeVar

from cm.client.core.calls import Call
from cm.client.find_manager import Place
from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.wire.messages.requests import ReleaseLease, RenewLease, TakeLease

_T = TypeVar("_T")


class HeldLeases:
    """The ids of a board's own leases; they go along with each request that takes a lease and names none."""

    def __init__(self) -> None:
        self.held: tuple[str, ...] = ()

    def add(self, lease: str) -> None:
        """One was taken."""
        self.held = (*self.held, lease)

    def remove(self, lease: str) -> None:
        """One was given back."""
        self.held = tuple([held for held in self.held if held != lease])

    def named(self, lease: str) -> str:
        """The ids to send: `lease` if it is given, else all that are held."""
        return lease or ",".join(self.held)

    def carried(self, call: Call[_T]) -> Call[_T]:
        """The call with the ids of the leases."""
        request: Any = call.request
        if not self.held or getattr(request, "lease", None) != "":
            return call
        return replace(call, request=replace(request, lease=self.named("")))


def wanted(scope: str, exclusive: bool, seconds: float, holder: str, place: Place) -> TakeLease:
    """The request for a new one. On the manager's machine it ends with this process."""
    local, holder = place.local, holder or place.guest
    pid = os.getpid() if local else 0  # a pid of another machine would mean another process there
    return TakeLease(scope, exclusive, seconds=seconds, holder=holder or f"pid {os.getpid()}", pid=pid)


def renewal(lease: TakeLease, identity: str) -> RenewLease:
    """The request that restarts its time. Raises InvalidRequest if it was not taken, or was given back."""
    if not identity:
        raise InvalidRequest(f"the lease on {lease.scope} is not held: take() it, or enter it as a context manager")
    return RenewLease(identity, lease.seconds)


def release(identity: str) -> ReleaseLease:
    """The request that gives it back."""
    return ReleaseLease(identity)
