# SPDX-License-Identifier: Apache-2.0
"""The budget of one client: requests under way, bytes that wait for it and for the manager, the loop's time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import ClassVar, Protocol

from cm.errors import Busy
from cm.server.shares.names import Tracker
from cm.server.shares.turns import Account, Client
from cm.wire.messages.status import Reply

_PROBE = 16 << 10  # bytes of replies to a connection, after each of which one is tracked
LITTLE = 2 * _PROBE  # bytes of replies that each connection may leave unread, whatever others do
_REPLY = 320  # bytes of overhead that ZeroMQ needs for a reply
_SENDERS = 1024  # connections whose replies are counted one by one
PENDING = 64  # long requests of one client at a time: reads of data, changes, configurations that are stored


class TooMuchWaiting(Busy):
    """A client has sent more than may wait; its earlier requests have to be served first."""

    code: ClassVar[str] = "too_much_waiting"


class RepliesUnread(Busy):
    """A client requests more without reading the replies that it was sent."""

    code: ClassVar[str] = "replies_unread"


_Sent = tuple[Tracker, int, Hashable]  # tracker of the last of several replies, their bytes, their connection


class AllClients(Protocol):
    """The totals of all clients."""

    queued_bytes: int  # of messages that wait for their turn
    leaving_bytes: int  # of replies that are being made, or were not read

    def waiting_bytes(self) -> int:
        """Of requests that wait."""

    def look_at_replies(self) -> None:
        """Count those that were read."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of one client: bytes of requests that wait, and of replies that it does not read.

    All clients of an account together may have an eighth more, all clients one and a half times as many; beyond that,
    only a client that has nothing waiting gets a request through.
    """

    waiting_bytes: int
    replies_bytes: int


class Budget(Client):
    """One client's."""

    __slots__ = (
        "_all", "_sent", "_unknown", "_unread", "_untold", "bounds", "connections", "leaving_bytes", "made_bytes",
        "name", "pending", "place", "refused", "requests", "upload_bytes", "waiting_bytes",
    )  # fmt: skip

    def __init__(self, name: str, bounds: Bounds, of_all: AllClients, account: Account) -> None:
        super().__init__(account)
        self.name = name
        self._all = of_all
        self.bounds = bounds
        self.connections = 0
        self.place = ""  # the place where its connections come from
        self.requests = 0
        self.refused = 0
        self.pending = 0  # long requests under way
        self.waiting_bytes = 0  # of requests that wait
        self.made_bytes = 0  # of replies that are being made
        self.leaving_bytes = 0  # these, and those of replies that were unread when we last looked
        self.upload_bytes = 0
        self._sent: deque[_Sent] = deque()
        self._unread: dict[Hashable, int] = {}  # bytes of these, by connection
        self._untold: dict[Hashable, int] = {}  # bytes of replies to each connection since the last tracked one
        self._unknown = 0  # the same for connections that have gone

    def begin(self, size: int = 0) -> None:
        """Begin a request that holds `size` bytes. Raises TooMuchWaiting; otherwise `end` must follow."""
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
        """Count a message of `size` bytes that waits for its turn. Raises TooMuchWaiting; else `unqueue` follows."""
        if self._has_too_much_queued(size):
            queued = self._all.queued_bytes
            raise TooMuchWaiting(
                f"{self.waiting} requests of {self.name} wait, {self.queued_bytes} bytes with what it takes to keep "
                f"them, {queued} of all (limits.waiting_mib): wait for an answer"
            )
        self.queued(1, size)

    def _has_too_much_queued(self, more: int) -> bool:
        """A client that has nothing waiting may always send a short message, and a long one if its account has none."""
        own, account, most = self.queued_bytes, self.account.queued_bytes, self.bounds.waiting_bytes
        if not own and (more <= LITTLE or not account):
            return False
        return own + more > most or account + more > most * 9 // 8 or self._all.queued_bytes + more > most * 3 // 2

    def unqueue(self, size: int) -> None:
        """It is its turn."""
        self.queued(-1, -size)

    def queued(self, messages: int, size: int) -> None:
        """So many more wait; fewer, if negative."""
        self.waiting += messages
        self.queued_bytes += size
        self.account.queued_bytes += size
        self._all.queued_bytes += size

    @property
    def has_much_waiting(self) -> bool:
        """Whether so much has come and not been served that messages still on their way need the remaining room."""
        return self.queued_bytes > self.bounds.waiting_bytes // 4

    @property
    def has_little_waiting(self) -> bool:
        """Then more may come."""
        return self.queued_bytes < self.bounds.waiting_bytes // 8

    def has_room(self, reply: int = 0) -> bool:
        """Whether a reply of that many bytes may be made for it now: whether it reads what it requests."""
        if not self._is_full(reply):
            return True
        self.look_at_replies()
        if not self._is_full(reply):
            return True
        self._all.look_at_replies()
        return not self._is_full(reply)

    def reads(self, sender: Hashable) -> bool:
        """Whether one of its connections gets more replies: it has read nearly all of them, or there is room."""
        if self.leaving_bytes <= LITTLE or self._unread.get(sender, 0) <= LITTLE or not self._is_full(0):
            return True
        self._all.look_at_replies()
        return not self._is_full(0) or self._unread.get(sender, 0) <= LITTLE

    def _is_full(self, more: int) -> bool:
        """Whether there is no room, as far as is known.

        A client with little unread gets a short reply all the same, and a long one if its account has none.
        """
        own, account, most = self.leaving_bytes, self.account.leaving_bytes, self.bounds.replies_bytes
        if own and own + more > most:
            return True
        if account + more <= most * 9 // 8 and self._all.leaving_bytes + more <= most * 3 // 2:
            return False
        return own > LITTLE if more <= _PROBE else account > 0

    def check_room(self) -> None:
        """Raise RepliesUnread if so much is unread that it gets no more."""
        if not self.has_room(1):
            raise RepliesUnread(
                f"{self.leaving_bytes} bytes of answers to {self.name} are under way or unread, "
                f"{self._all.leaving_bytes} to all (limits.replies_mib): read them first"
            )

    def make(self, size: int) -> None:
        """A reply of that many bytes is being made (negative: is done)."""
        self.made_bytes += size
        self._leaving(size)

    def replied(self, sender: Hashable, size: int) -> int:
        """Count a reply of `size` bytes to one of its connections.

        Returns 0, or the bytes that will be known to have been read once this reply has been: then it is to be sent
        with a tracker, which goes to `sent`.
        """
        untold = self._untold.get(sender, self._unknown) + size + _REPLY
        if untold < _PROBE:
            self._untold[sender] = untold
            return 0
        self._untold[sender] = 0
        return untold

    def sent(self, tracker: Tracker, size: int, sender: Hashable) -> None:
        """Replies of that many bytes were passed to ZeroMQ, the last of them with a tracker."""
        self._sent.append((tracker, size, sender))
        self._unread[sender] = self._unread.get(sender, 0) + size
        self._leaving(size)
        if self._sent[0][0].done:
            self.look_at_replies()

    def look_at_replies(self) -> None:
        """Count those that were read."""
        waiting = [sent for sent in self._sent if not sent[0].done]
        if len(waiting) == len(self._sent):
            return
        self._sent = deque(waiting)
        self._unread = {}
        for _, size, sender in waiting:
            self._unread[sender] = self._unread.get(sender, 0) + size
        self._leaving(sum(self._unread.values()) + self.made_bytes - self.leaving_bytes)

    def forget_connections(self) -> None:
        """Some connections may have gone; unread replies to the others still count."""
        if len(self._untold) > _SENDERS:
            self._untold.clear()
            self._unknown = _PROBE

    def _leaving(self, size: int) -> None:
        self.leaving_bytes += size
        self.account.leaving_bytes += size
        self._all.leaving_bytes += size

    @property
    def unread_bytes(self) -> int:
        """The bytes of replies that ZeroMQ still has, except for less than 16 KiB of each connection."""
        self.look_at_replies()
        return self.leaving_bytes - self.made_bytes

    def end(self, size: int = 0) -> None:
        """It was answered."""
        self.pending -= 1
        self.waiting_bytes -= size

    def under_way(self, respond: Callable[[Reply], None], size: int) -> Callable[[Reply], None]:
        """As `begin`; returns the function that replies and ends the request."""
        self.begin(size)

        def answered(made: Reply) -> None:
            self.end(size)
            respond(made)

        return answered

    @property
    def idle(self) -> bool:
        """Whether it has nothing waiting and nothing unread."""
        return not (self.connections or self.pending or self.waiting or self.upload_bytes or self.leaving_bytes)


def _is_full(own: int, more: int, most: int, of_all: Callable[[], int]) -> bool:
    """Whether that many more bytes are too many; never for a client that has none."""
    return own > 0 and (own + more > most or of_all() + more > most * 3 // 2)
