# SPDX-License-Identifier: Apache-2.0
"""Connections whose reading is paused, so that what their clients send waits in the clients' own sockets."""

from __future__ import annotations

from typing import Protocol

from cm.server.shares.budget import Budget


class Connections(Protocol):
    """Connections by their descriptors, each with the place that it comes from (`Budget.place`)."""

    def hold(self, fd: int, place: str) -> bool:
        """Stop reading a connection; False if it comes from another place."""

    def release(self, fd: int) -> None:
        """Read it again."""

    def cut(self, fd: int, place: str) -> None:
        """End it."""


class PausedConnections:
    """The connections that are paused, by the clients that they belong to."""

    def __init__(self, connections: Connections) -> None:
        self._connections = connections
        self.held: dict[Budget, set[int]] = {}

    def hold(self, budget: Budget, fd: int) -> None:
        """Stop reading one of its connections."""
        if self._connections.hold(fd, budget.place):
            self.held.setdefault(budget, set()).add(fd)

    def release(self, budget: Budget) -> None:
        """Read its connections again, once few of its bytes wait."""
        if budget.has_little_waiting:
            for fd in self.held.pop(budget):
                self._connections.release(fd)

    def cut(self, budget: Budget, fd: int) -> None:
        """End one of its connections."""
        self._connections.cut(fd, budget.place)
