# SPDX-License-Identifier: Apache-2.0
"""Time that several clients pay for: what is done at once for all who came, such as subscribers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Protocol


class Payer(Protocol):
    """One who pays for the loop's time: a client, or those who share a bill."""

    def charge(self, nanoseconds: int, /) -> None:
        """That much was used."""


class Bill:
    """A payer that divides what it is charged among connections, by how often each came."""

    def __init__(self, payer: Callable[[str], Payer]) -> None:
        """`payer` finds the client of a connection by its id."""
        self._payer = payer
        self._came = Counter[str]()

    def add(self, connection: str) -> None:
        """It came once more; an empty id is that of nobody known, who does not pay."""
        self._came[connection] += 1

    def charge(self, nanoseconds: int) -> None:
        """Everyone pays a share; nobody, if nobody came."""
        for connection, count in self._came.items():
            if connection:
                self._payer(connection).charge(nanoseconds * count // self._came.total())
