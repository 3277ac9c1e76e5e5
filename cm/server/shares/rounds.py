# SPDX-License-Identifier: Apache-2.0
"""Rounds of a socket's connections: one message of each that has some is taken in, before the next of any."""

from __future__ import annotations

from collections.abc import Hashable

_QUIET = 8  # messages that are served after a round that brought nothing new


class Round:
    """How far a socket's round is."""

    def __init__(self) -> None:
        self._seen: set[Hashable] = set()  # connections, in this round
        self._news = False  # whether this round brought a message of a client that had none waiting
        self.quiet = 0  # messages to be served before the next round

    def came(self, connection: Hashable, news: bool) -> bool:
        """Note a message; whether that ended a round."""
        self._news = self._news or news
        if connection not in self._seen:
            self._seen.add(connection)
            return False
        self._seen = {connection}
        self.quiet = 0 if self._news else _QUIET
        self._news = False
        return True

    def is_quiet(self) -> bool:
        """Whether the next round has to wait for one more message to be served."""
        if self.quiet:
            self.quiet -= 1
            return True
        return False
