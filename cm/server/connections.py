# SPDX-License-Identifier: Apache-2.0
"""The connections over ZeroMQ, and how many: `cm.device.native.guard` below libzmq, with this manager's bounds.

libzmq cannot refuse a connection, and ends its process when descriptors run out; docs/decisions/guarded-connections.md
says what was tried.
"""

from __future__ import annotations

import logging
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from cm.device.native import guard
from cm.device.native.guard import REQUESTS, TOPICS
from cm.loop import Loop
from cm.server.intake import Intake
from cm.server.limits import Limits
from cm.server.shares.budget import Bounds
from cm.server.shares.names import Who, place_of
from cm.server.shares.registry import Budgets
from cm.server.uploads import Uploads

__all__ = ["REQUESTS", "TOPICS", "Connections", "listening", "raise_descriptors"]

_LOG = logging.getLogger("cm")
_DESCRIPTORS = 65536  # requested, if as many are allowed
_RESERVE = 128  # descriptors that no connection takes: for devices, frames, files and leases
_NEWCOMERS = 64  # connections for clients that have few
PARTS = 300  # of one message
_TOPICS = 1024  # subscriptions and unsubscriptions at once; 64 more each second
_CAUSES = {
    "full": "as many are connected as may be (limits.connections)",
    "each": "it has as many connections as one client may have (limits.connections_each)",
    "descriptors": "the other descriptors of this process are kept for the manager's own work (RLIMIT_NOFILE)",
    "protocol": "it does not speak ZMTP 3",
    "parts": f"it sent a message of more than {PARTS} parts",
    "bytes": "it sent a message that is too long, or has no end (limits.message_mib)",
    "rate": f"it subscribed to more than {_TOPICS} topics at once, or four times as many over all its connections",
    "cut": "it has lost its right to be connected, or does not read its answers and goes on asking",
    "unread": "it has read nothing for longest of those that leave frames unread, which are too many (--stream-queue)",
    "often": "it connects more often than limits.connections_each times a second, while others wait to be let in",
    "slow": "others had long messages to send while it did not end one (64 KiB in a second, 10 s in all)",
}


def raise_descriptors() -> None:
    """Allow this process as many descriptors as it may have, up to 65,536."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _DESCRIPTORS if hard == resource.RLIM_INFINITY else min(_DESCRIPTORS, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


@contextmanager
def listening(kind: int) -> Iterator[None]:
    """Sockets that this thread binds meanwhile are guarded."""
    guard.expect(kind)
    try:
        yield
    finally:
        guard.expect(guard.NONE)


class Guarded:
    """Connections by their descriptors, as long as they come from the expected place."""

    def hold(self, fd: int, place: str) -> bool:
        """Stop reading a connection; False if it comes from another place."""
        with suppress(OSError):
            if place_of(guard.peer(fd)) == place:
                guard.hold(fd, True)
                return True
        return False

    def release(self, fd: int) -> None:
        """Read it again."""
        with suppress(OSError):  # it has gone
            guard.hold(fd, False)

    def cut(self, fd: int, place: str) -> None:
        """End it."""
        with suppress(OSError):
            if place_of(guard.peer(fd)) == place:
                guard.cut(fd)


class Connections:
    """Sets the bounds, knows what each client uses, and logs now and then which connections were refused."""

    def __init__(
        self,
        limits: Limits,
        who: Callable[[str], Who],
        folder: Path,
        loop: Loop,
    ) -> None:
        raise_descriptors()
        if not guard.install():
            _LOG.warning("connections cannot be limited here: libzmq does not call the C library by its tables")
        guard.limit(bounds(limits))
        each = Bounds(limits.waiting_bytes, limits.replies_bytes)
        self.budgets = budgets = Budgets(each, who, guard.taken, guard.peers, limits.shares)
        self.intake = Intake(budgets, loop, Guarded())
        self.uploads = Uploads(folder, limits.upload_bytes, limits.uploads_bytes, budgets.upload_bytes)
        self._message_bytes = limits.message_bytes
        self._told = guard.counts().refused

    def renew(self, limits: Limits) -> None:
        """Apply other bounds from now on; a client that exceeds them keeps what it has.

        The length of messages stays.
        """
        guard.limit(bounds(replace(limits, message_bytes=self._message_bytes)))
        self.budgets.renew(Bounds(limits.waiting_bytes, limits.replies_bytes), limits.shares)
        self.uploads.renew(limits.upload_bytes, limits.uploads_bytes)

    def close(self) -> None:
        """Forget what was sent in parts."""
        self.uploads.close()

    def tell(self) -> None:
        """Forget clients that have gone, and log refusals since the last call: one line for each cause."""
        guard.look_on()
        self.uploads.forget_old()
        self.budgets.settle()
        now = guard.counts()
        for cause, count in now.refused.items():
            more = count - self._told[cause]
            if more:
                name = place_of(now.last) if cause == now.last_cause else "others"
                _LOG.warning("%d connections refused, the last of %s: %s", more, name, _CAUSES[cause])
        self._told = now.refused


def bounds(limits: Limits) -> guard.Limits:
    """The bounds as the guard has them."""
    newcomers = min(_NEWCOMERS, limits.connections // 4)
    return guard.Limits(
        limits.connections, limits.connections_each, newcomers, _RESERVE, PARTS, limits.message_bytes, _TOPICS
    )
