# SPDX-License-Identifier: Apache-2.0
"""The clients of the manager: what each has under way, the most that it may have, and whose turn it is.

A client is a process of this machine, a key, or an address without one, whatever its connections. Numbers only: no
sockets, no requests.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from pathlib import Path
from time import monotonic_ns
from types import MappingProxyType
from typing import ClassVar, Generic, TypeVar

import zmq

from cm.errors import Busy
from cm.frozen import replace
from cm.server.rights.principal import Principal
from cm.server.settings.model import Limits
from cm.wire.messages.status import ClientStatus, LeaseStatus, StreamStatus

_T = TypeVar("_T")
_NOTHING: Mapping[str, int] = MappingProxyType({})
Turn = tuple[Hashable, Hashable]  # a user, and one of its clients; for work of the manager's own, anything twice


class Ring(Generic[_T]):
    """Round robin among users, and among the clients of each, however much they have waiting."""

    def __init__(self) -> None:
        self._users: dict[Hashable, dict[Hashable, deque[_T]]] = {}  # in the order in which they come next

    def __bool__(self) -> bool:
        return bool(self._users)

    def __len__(self) -> int:
        """How many clients have something waiting."""
        return sum(map(len, self._users.values()))

    def count(self, user: Hashable) -> int:
        """How much of a user's waits."""
        return sum(map(len, self._users.get(user, {}).values()))

    def add(self, turn: Turn, item: _T) -> None:
        """Add something behind all else of its client."""
        self._users.setdefault(turn[0], {}).setdefault(turn[1], deque()).append(item)

    def put_back(self, turn: Turn, item: _T) -> None:
        """Something that was taken waits again, before all else of its client."""
        self._users.setdefault(turn[0], {}).setdefault(turn[1], deque()).appendleft(item)

    def take(self) -> tuple[Turn, _T]:
        """The first of the client whose turn it is, who comes last then. Raises StopIteration if there is none."""
        user = next(iter(self._users))
        clients = self._users.pop(user)
        client = next(iter(clients))
        line = clients.pop(client)
        item = line.popleft()
        if line:
            clients[client] = line
        if clients:
            self._users[user] = clients
        return (user, client), item

    def clear(self) -> None:
        """Forget all."""
        self._users.clear()


PENDING = 64  # long requests of one user at a time: reads of data, changes, configurations that are stored
LITTLE = 32 << 10  # bytes of replies that a client may leave unread, whatever others do
TRACKED = 16 << 10  # bytes of replies over a connection, after each of which we are told that they were read
REPLY = 320  # bytes of overhead that ZeroMQ needs for a reply
_LOOK = 1_000_000  # nanoseconds at least between two looks at what all clients have read,
_REST = 10  # and that many times what the first took
_SENDERS = 1024  # connections whose replies are counted one by one
_REMEMBERED = 256  # clients that are remembered although they have nothing under way


class TooMuchWaiting(Busy):
    """A client has sent more than may wait; its earlier requests have to be served first."""

    code: ClassVar[str] = "too_much_waiting"


class RepliesUnread(Busy):
    """A client requests more without reading the replies that it was sent."""

    code: ClassVar[str] = "replies_unread"


class User:
    """A user, key or address: what its clients hold together is what one may hold."""

    __slots__ = ("clients", "sender")

    def __init__(self) -> None:
        self.clients: list[Client] = []
        self.sender = b""  # over which connection one of them asked last


class Client:
    """One of them. The loop's thread."""

    __slots__ = (
        "_all", "_made", "_sent", "account", "changes", "name", "pending", "pid", "place", "refused", "requests",
        "sender", "turn", "unread_bytes", "unread_of", "upload_bytes", "user", "waiting_bytes", "who",
    )  # fmt: skip

    def __init__(self, name: str, who: Principal, of_all: Clients) -> None:
        self._all = of_all
        self.name = name
        self.account = who.account
        self.turn: Turn = (who.account, name)
        self.user = of_all.users.setdefault(who.account, User())
        self.user.clients.append(self)
        self.who = str(who)  # as logs have it
        self.pid = who.pid
        self.place = place_of(who.pid, who.address)
        self.sender = b""  # over which connection it asked last
        self.requests = self.refused = 0
        self.pending = 0  # long requests under way
        self.waiting_bytes = 0  # of them
        self.changes = 0  # that wait or run
        self.upload_bytes = 0
        self.unread_bytes = 0  # of replies that are being made, or were unread when we last looked
        self.unread_of: dict[bytes, int] = {}  # the latter, by connection
        self._made = 0  # the former
        self._sent: deque[tuple[zmq.MessageTracker, int, bytes]] = deque()

    # ---- requests that take long ------------------------------------------------------------

    def begin(self, size: int) -> None:
        """A request of `size` bytes that takes long is under way. Raises TooMuchWaiting."""
        if sum([client.pending for client in self.user.clients]) >= PENDING:
            raise TooMuchWaiting(f"{PENDING} requests of {self.account} are under way; ask again when one has ended")
        self.queue(size)
        self.pending += 1

    def ended(self, size: int) -> None:
        """It is answered."""
        self.pending -= 1
        self.waiting_bytes -= size

    def queue(self, size: int) -> None:
        """Count the bytes of a request that waits, until they are taken off `waiting_bytes`. Raises TooMuchWaiting."""
        most, of_all = self._all.limits.waiting_bytes, self._all.waiting_bytes()
        own = sum([client.waiting_bytes for client in self.user.clients])
        if own and (own + size > most or of_all + size > most * 3 // 2):
            raise TooMuchWaiting(
                f"{own} bytes of {self.account} wait, {of_all} of all; "
                f"{size} more are too many (limits.waiting_mib): wait for an answer"
            )
        self.waiting_bytes += size

    # ---- replies ----------------------------------------------------------------------------

    def has_room(self, reply: int = 0) -> bool:
        """Whether a reply of that many bytes may be made for it now: whether it reads what it requests."""
        if not self._is_full(reply):
            return True
        self._all.count_unread()
        return not self._is_full(reply)

    def _is_full(self, reply: int) -> bool:
        """Whether there is no room, as far as is known; never for a user that has nothing unread."""
        own, most = self._unread_of_user(), self._all.limits.replies_bytes
        if self.unread_bytes + reply <= LITTLE or not own:
            return False
        return own + reply > most or self._all.unread_bytes() + reply > most * 3 // 2

    def _unread_of_user(self) -> int:
        return sum([client.unread_bytes for client in self.user.clients])

    def reads(self, sender: bytes) -> bool:
        """Whether one of its connections gets more replies: it has read nearly all of them, or there is room."""
        return self.unread_of.get(sender, 0) <= LITTLE or self.has_room() or self.unread_of.get(sender, 0) <= LITTLE

    @property
    def reads_nothing(self) -> bool:
        """Whether it goes on asking with twice as much unread as it may have: not even refusals are worth sending."""
        return self.unread_bytes > 2 * self._all.limits.replies_bytes

    def check_room(self) -> None:
        """Raise RepliesUnread if so much is unread that it gets no more."""
        if not self.has_room(1):
            raise self.unread()

    def unread(self) -> RepliesUnread:
        """What it is told then."""
        return RepliesUnread(
            f"{self._unread_of_user()} bytes of answers to {self.account} are under way or unread, "
            f"{self._all.unread_bytes()} to all (limits.replies_mib): read them first"
        )

    def make(self, size: int) -> None:
        """A reply of that many bytes is being made (negative: is done)."""
        self._made += size
        self.unread_bytes += size

    def sent(self, tracker: zmq.MessageTracker, size: int, sender: bytes) -> None:
        """Replies of that many bytes were passed to ZeroMQ over a connection, the last of them with a tracker."""
        self._sent.append((tracker, size, sender))
        self.unread_of[sender] = self.unread_of.get(sender, 0) + size
        self.unread_bytes += size
        if self._sent[0][0].done:
            self.count_unread()

    def count_unread(self) -> None:
        """Count those that were read."""
        if self._sent:
            self._sent = deque([sent for sent in self._sent if not sent[0].done])
            self.unread_of = {}
            for _, size, sender in self._sent:
                self.unread_of[sender] = self.unread_of.get(sender, 0) + size
            self.unread_bytes = self._made + sum(self.unread_of.values())

    @property
    def idle(self) -> bool:
        """Whether it has nothing under way and nothing unread."""
        return not (self.pending or self.changes or self.upload_bytes or self.unread_bytes)


class Clients:
    """All of them, by their names, and the client of each connection. The loop's thread."""

    def __init__(self, limits: Limits, who: Callable[[str], Principal]) -> None:
        """`who` finds clients by the ids of their connections (ZMQ's User-Id)."""
        self.limits = limits
        self._who = who
        self._named: dict[str, Client] = {}
        self.users: dict[str, User] = {}
        self.known: dict[str, Client] = {}  # by connection
        self._next_count = 0  # when, in nanoseconds
        self.untold: dict[bytes, int] = {}  # of who replies: bytes over each connection since the last tracked one

    def __iter__(self) -> Iterator[Client]:
        return iter(self._named.values())

    def of(self, connection: str) -> Client:
        """The client that a connection belongs to."""
        client = self.known.get(connection)
        if client is None:
            who = self._who(connection)
            name = _name_of(who)
            client = self._named.get(name) or Client(name, who, self)
            self.known[connection] = self._named[name] = client
        return client

    def waiting_bytes(self) -> int:
        """Of requests of all clients."""
        return sum([client.waiting_bytes for client in self])

    def unread_bytes(self) -> int:
        """Of replies to all clients."""
        return sum([client.unread_bytes for client in self])

    def upload_bytes(self) -> int:
        """Of all clients."""
        return sum([client.upload_bytes for client in self])

    def count_unread(self) -> None:
        """Count the replies that were read, of all clients, unless that was done just now."""
        began = monotonic_ns()
        if began >= self._next_count:
            for client in self:
                client.count_unread()
            self._next_count = monotonic_ns() + max(_LOOK, _REST * (monotonic_ns() - began))

    def settle(self) -> None:
        """Once in a while: keep what is remembered of clients that may have gone within bounds."""
        self.count_unread()
        if len(self.untold) > _SENDERS:
            self.untold.clear()
        if max(len(self._named), len(self.known)) > _REMEMBERED:
            self._forget(frozenset())

    def _forget(self, there: Iterable[str]) -> None:
        """Forget clients that have nothing under way, but for those in these places."""
        self._named = {n: client for n, client in self._named.items() if not client.idle or client.place in there}
        for user in self.users.values():
            user.clients = [client for client in user.clients if client.name in self._named]
        self.users = {account: user for account, user in self.users.items() if user.clients}
        for gone in [key for key, client in self.known.items() if client.name not in self._named]:
            del self.known[gone]

    def statuses(
        self,
        connections: Mapping[str, int],
        leases: Iterable[LeaseStatus] = (),
        streams: Iterable[StreamStatus] = (),
        memory: Mapping[str, int] = _NOTHING,
    ) -> tuple[ClientStatus, ...]:
        """What every client has now, with the leases, the slots of streams and the bytes of `memory` that it holds.

        `connections`: how many lead to each place.
        """
        self.count_unread()
        self._forget(connections)
        held, slots = Counter(lease.client for lease in leases), Counter[str]()
        for stream in streams:
            for reader in stream.clients:
                slots[f"pid {reader.pid} ({reader.name})"] += reader.depth
        found = []
        for name in sorted({*self._named, *held, *slots, *memory}):
            client = self._named.get(name)
            status = ClientStatus(name, leases=held[name], slots=slots[name], memory_bytes=memory.get(name, 0))
            if client is not None:
                status = replace(
                    status,
                    connections=connections.get(client.place, 0),
                    upload_bytes=client.upload_bytes,
                    waiting_bytes=client.waiting_bytes + client.unread_bytes,
                    unread_bytes=client.unread_bytes,
                    requests=client.requests,
                    refused=client.refused,
                    account=client.account,
                    waiting=client.pending,
                )
            found.append(status)
        return tuple(found)


def place_of(pid: int | None, address: str) -> str:
    """Where a connection comes from: ``pid 123``, or an address."""
    return f"pid {pid}" if pid is not None else address.removeprefix("::ffff:")


def _name_of(who: Principal) -> str:
    """A client's name for people: ``pid 123 (python3)``, ``key laptop``, or an address."""
    if who.pid is None:
        return f"key {who.name or who.key}" if who.key else who.address or "somebody"
    try:
        return f"pid {who.pid} ({Path(f'/proc/{who.pid}/comm').read_text('utf-8', 'replace').strip()})"
    except OSError:
        return f"pid {who.pid}"
