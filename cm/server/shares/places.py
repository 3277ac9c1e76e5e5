# SPDX-License-Identifier: Apache-2.0
"""Places in a queue that all clients share: a client that has some leaves the last ones to others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from cm.errors import Busy
from cm.server.shares.budget import Budget

_OTHERS, _NEWCOMERS = 4, 8  # one place in 4 is for clients that have none, one in 8 for such accounts


class Places:
    """How many places each holds. A quarter is for clients that have none, half of that for other accounts."""

    def __init__(self, count: int, what: str) -> None:
        """`what`: what waits there, in words for messages."""
        self._count = count
        self._what = what
        self._held: Counter[Budget] = Counter()

    def take(self, client: Budget) -> Callable[[], None]:
        """Take a place for a client; returns the function that gives it back. Raises Busy."""
        free = self._count - self._held.total()
        own = self._held[client]
        account = sum([held for other, held in self._held.items() if other.account is client.account])
        if free <= 0 or (own and free <= self._count // _OTHERS) or (account and free <= self._count // _NEWCOMERS):
            raise Busy(
                f"{self._what}: {own} of {client.name}, {account} of {client.account.name}, {self._held.total()} of "
                f"all wait or run, of {self._count}, the last of which are for others; try again when one has ended"
            )
        self._held[client] += 1
        return lambda: self._give_back(client)

    def _give_back(self, client: Budget) -> None:
        self._held[client] -= 1
        if not self._held[client]:
            del self._held[client]
