# SPDX-License-Identifier: Apache-2.0
"""What a node offers to the server: sessions, and answers that may come later or bring descriptors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from cm.sim.errors import NodeError
from cm.sim.transport.events import Events


class Later:
    """The answer to a request that takes time: call `finish` once, whenever it is known."""

    def __init__(self) -> None:
        self._callback: Callable[[bytes | NodeError], None] | None = None
        self._result: bytes | NodeError | None = None

    def finish(self, result: bytes | NodeError = b"") -> None:
        """Answer with a payload, or with an error."""
        self._result = result
        if self._callback is not None:
            self._callback(result)

    def then(self, callback: Callable[[bytes | NodeError], None]) -> None:
        """Have `callback` called with the result, at once if there is one."""
        self._callback = callback
        if self._result is not None:
            callback(self._result)


class Answer:
    """A payload with descriptors; the connection closes them when they are sent."""

    __slots__ = ("fds", "payload")

    def __init__(self, payload: bytes, fds: Sequence[int] = ()) -> None:
        self.payload = payload
        self.fds = fds


class Opened:
    """A session, and what its greeting offers (``CM_NODE_OFFERS_*``)."""

    __slots__ = ("offers", "session")

    def __init__(self, session: Session, offers: int) -> None:
        self.session = session
        self.offers = offers


class Session(Protocol):
    """One open file of a node."""

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Answer | Later:
        """Answer a request or raise `NodeError`. `fds` are closed by the caller."""

    def write(self, data: bytes) -> None:
        """The client wrote to the event socket."""

    def close(self) -> None:
        """The client has gone: release what it held."""


class Node(Protocol):
    """What listens at a path."""

    def open(self, events: Events) -> Session | Opened:
        """A client connects; raise `NodeError` to make its open() fail."""
