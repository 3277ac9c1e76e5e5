# SPDX-License-Identifier: Apache-2.0
"""One client's: requests under way, bytes that wait for it and for the manager, the loop's time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

from cm.budgets.turns import Account, Client
from cm.errors import Busy
from cm.messages.status import Reply

PENDING = 64  # requests of one client that take their time: reads of data, changes, configurations that are stored


class TooMuchWaiting(Busy):
    """A client has sent more than may wait for it; what it sent before has to be done first."""

    code: ClassVar[str] = "too_much_waiting"


class RepliesUnread(Busy):
    """A client asks for more while it leaves the answers that it got unread."""

    code: ClassVar[str] = "replies_unread"


class Tracker(Protocol):
    """Of a message that was given to ZeroMQ (`zmq.MessageTracker`)."""

    @property
    def done(self) -> bool:
        """Whether it has left."""


class AllClients(Protocol):
    """What all clients have together."""

    queued_bytes: int  # of messages that wait for their turn

    def waiting_bytes(self) -> int:
        """Of requests that wait."""

    def leaving_bytes(self) -> int:
        """Of replies that are being made, or were not read."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Of one client: bytes of requests that wait, and of replies that it does not read.

    All clients together may have one and a half times as many waiting, and unread; beyond that only who has nothing
    there gets a request through.
    """

    waiting_bytes: int
    replies_bytes: int


class Budget(Client):
    """One client's."""

    __slots__ = (
        "_all", "_replies", "bounds", "connections", "name", "pending", "place", "refused", "replies_bytes",
        "requests", "upload_bytes", "waiting_bytes",
    )  # fmt: skip

    def __init__(self, name: str, bounds: Bounds, of_all: AllClients, account: Account) -> None:
        super().__init__(account)
        self.name = name
        self._all = of_all
        self.bounds = bounds
        self.connections = 0
        self.place = ""  # where its connections come from
        self.requests = 0
        self.refused = 0
        self.pending = 0  # requests under way that take their time
        self.waiting_bytes = 0  # of requests that wait
        self.replies_bytes = 0  # that are being made
        self.upload_bytes = 0
        self._replies: deque[tuple[Tracker, int]] = deque()  # large ones that were sent, perhaps not read

    def begin(self, size: int = 0) -> None:
        """A request is under way that holds `size` bytes. Raises TooMuchWaiting; else `end` follows."""
        if self.pending >= PENDING:
            raise TooMuchWaiting(f"{PENDING} requests of {self.name} are under way; ask again when one has ended")
        most = self.bounds.waiting_bytes
        if size and _is_full(self.waiting_bytes, size, most, self._all.waiting_bytes):
            raise TooMuchWaiting(
                f"{self.waiting_bytes} bytes of {self.name} wait, {self._all.waiting_bytes()} of all; "
                f"{size} more are too many (limits.waiting_mib): wait for an answer"
            )
        self.pending += 1
        self.waiting_bytes += size

    def queue(self, size: int) -> None:
        """A message of `size` bytes waits for its turn. Raises TooMuchWaiting; else `unqueue` follows."""
        most, account, queued = self.bounds.waiting_bytes, self.account, self._all.queued_bytes
        if (self.queued_bytes and self.queued_bytes + size > most) or (
            account.queued_bytes and (account.queued_bytes + size > most * 9 // 8 or queued + size > most * 3 // 2)
        ):
            raise TooMuchWaiting(
                f"{self.waiting} requests of {self.name} wait, {self.queued_bytes} bytes with what it takes to keep "
                f"them, {queued} of all (limits.waiting_mib): wait for an answer"
            )
        self._queued(1, size)

    def unqueue(self, size: int) -> None:
        """It is its turn."""
        self._queued(-1, -size)

    def _queued(self, messages: int, size: int) -> None:
        self.waiting += messages
        self.queued_bytes += size
        self.account.queued_bytes += size
        self._all.queued_bytes += size

    def has_room(self, reply: int) -> bool:
        """Whether so many bytes may be made for it now: whether it reads what it asked for."""
        return not _is_full(self.leaving_bytes, reply, self.bounds.replies_bytes, self._all.leaving_bytes)

    def check_room(self) -> None:
        """Raise RepliesUnread where it has not read so much that it gets no more."""
        if not self.has_room(1):
            raise RepliesUnread(
                f"{self.leaving_bytes} bytes of answers to {self.name} are under way or unread, "
                f"{self._all.leaving_bytes()} to all (limits.replies_mib): read them first"
            )

    @property
    def leaving_bytes(self) -> int:
        """Of replies that are being made, or were not read."""
        return self.unread_bytes + self.replies_bytes

    def end(self, size: int = 0) -> None:
        """It was answered."""
        self.pending -= 1
        self.waiting_bytes -= size

    def under_way(self, respond: Callable[[Reply], None], size: int) -> Callable[[Reply], None]:
        """As `begin`; what answers, and ends it."""
        self.begin(size)

        def answered(made: Reply) -> None:
            self.end(size)
            respond(made)

        return answered

    def sent(self, tracker: Tracker, size: int) -> None:
        """A large reply was given to ZeroMQ."""
        self._replies.append((tracker, size))

    @property
    def unread_bytes(self) -> int:
        """Of large replies that ZeroMQ still has."""
        replies = self._replies
        while replies and replies[0][0].done:
            replies.popleft()
        return sum([size for tracker, size in replies if not tracker.done]) if replies else 0

    @property
    def idle(self) -> bool:
        """Whether nothing is left of it."""
        return not (self.connections or self.pending or self.waiting or self.upload_bytes)


def _is_full(own: int, more: int, most: int, of_all: Callable[[], int]) -> bool:
    """Whether so many more bytes are too many; never for a client that has none."""
    return own > 0 and (own + more > most or of_all() + more > most * 3 // 2)
