# SPDX-License-Identifier: Apache-2.0
"""Whose turn it is: time is divided among accounts, and that of an account among its clients, by what each has used.

The one that has used least comes next (start-time fair queueing). Nobody saves time up: a client that comes back begins
where the others are; so does one that was alone and used much. A client's connections take turns.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from itertools import count
from typing import Generic, TypeVar

_T = TypeVar("_T")
_S = TypeVar("_S", bound="Spender")


class VirtualTime:
    """The virtual time of fair queueing: what those that are served now have used."""

    __slots__ = ("now",)

    def __init__(self) -> None:
        self.now = 0.0


class Spender:
    """An account or client that uses time, measured by `clock`."""

    __slots__ = ("clock", "spent")

    def __init__(self, clock: VirtualTime) -> None:
        self.clock = clock
        self.spent = clock.now

    def comes(self) -> None:
        """It has something waiting, perhaps after it had nothing for a while."""
        self.spent = max(self.spent, self.clock.now)

    def goes(self) -> None:
        """It is served."""
        self.clock.now = max(self.clock.now, self.spent)


class Account(Spender):
    """A user, a key or an address, whatever its connections. `share`: how many times as much it gets as others."""

    __slots__ = ("clients", "leaving_bytes", "name", "queued_bytes", "share")

    def __init__(self, name: str, clock: VirtualTime, share: float = 1.0) -> None:
        super().__init__(clock)
        self.name = name
        self.share = share
        self.clients = VirtualTime()
        self.queued_bytes = 0  # of messages that wait for their turn
        self.leaving_bytes = 0  # of replies that are being made, or were not read


class Client(Spender):
    """A process, a key or an address, which belongs to an account."""

    __slots__ = ("account", "busy_ns", "queued_bytes", "waiting")

    def __init__(self, account: Account) -> None:
        super().__init__(account.clients)
        self.account = account
        self.busy_ns = 0  # of the loop's time
        self.waiting = 0  # messages that wait for their turn
        self.queued_bytes = 0  # of them

    def charge(self, nanoseconds: int) -> None:
        """It used that much of the loop's time."""
        account = self.account
        self.busy_ns += nanoseconds
        self.spent += nanoseconds
        account.spent += nanoseconds / account.share

    def spend(self, nanoseconds: int) -> None:
        """It used that much processor time outside the loop, which others could not use."""
        self.spent += nanoseconds
        self.account.spent += nanoseconds / self.account.share

    def is_alone(self) -> None:
        """As `comes` and `goes`, where nobody else waits, as mostly: the same in less than half the time."""
        account = self.account
        if account.spent > account.clock.now:
            account.clock.now = account.spent
        else:
            account.spent = account.clock.now
        if self.spent > self.clock.now:
            self.clock.now = self.spent
        else:
            self.spent = self.clock.now

    def comes(self) -> None:
        """As it says above, with its account."""
        self.account.comes()
        super().comes()

    def goes(self) -> None:
        """As it says above, with its account."""
        self.account.goes()
        super().goes()


_C = TypeVar("_C", bound=Client)


class _Line(Generic[_S]):
    """Those that wait at one level: accounts, or an account's clients."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, _S]] = []
        self._numbers = count()  # among those that have used as much, the first to come is first

    def __bool__(self) -> bool:
        return bool(self._heap)

    def join(self, who: _S) -> None:
        """It is not in line yet."""
        heapq.heappush(self._heap, (who.spent, next(self._numbers), who))

    def leave(self) -> _S:
        """Remove and return the one that has used least. Raises IndexError."""
        while True:
            spent, _, who = heapq.heappop(self._heap)
            if who.spent <= spent:
                return who
            self.join(who)  # it has used more since


class Turns(Generic[_C, _T]):
    """What waits, by account, client and connection."""

    def __init__(self) -> None:
        self._accounts: _Line[Account] = _Line()
        self._clients: dict[Account, _Line[_C]] = {}
        self._there: dict[_C, dict[Hashable, deque[_T]]] = {}  # by connection, the next one first
        self._count = 0
        self.stopped: dict[_C, dict[Hashable, deque[_T]]] = {}  # messages of connections that get no turn now

    def __len__(self) -> int:
        return self._count

    @property
    def anyone(self) -> bool:
        """Whether anything waits that may be served."""
        return bool(self._accounts)

    def add(self, client: _C, connection: Hashable, item: _T) -> bool:
        """Add a message; returns whether it is the only one of its connection."""
        self._count += 1
        if self.stopped and connection in self.stopped.get(client, ()):
            self.stopped[client][connection].append(item)
            return False
        connections = self._there.get(client)
        if connections is None:
            connections = self._enter(client)
        items = connections.get(connection)
        if items is not None:
            items.append(item)
            return False
        connections[connection] = deque((item,))
        return True

    def again(self, client: _C, connection: Hashable, rest: _T) -> None:
        """What is left of something that was taken waits, before all else of its connection."""
        if not self.add(client, connection, rest):
            (self.stopped.get(client, {}).get(connection) or self._there[client][connection]).rotate(1)

    def _enter(self, client: _C) -> dict[Hashable, deque[_T]]:
        client.comes()
        self._line_up(client)
        made = self._there[client] = {}
        return made

    def _line_up(self, client: _C) -> None:
        account = client.account
        if account not in self._clients:
            self._clients[account] = _Line()
            self._accounts.join(account)
        self._clients[account].join(client)

    def go_on(self, may: Callable[[_C, Hashable], bool]) -> bool:
        """Give turns again to connections that may have them; returns whether there were any."""
        found = [(client, one) for client, held in self.stopped.items() for one in held if may(client, one)]
        for client, connection in found:
            connections = self._there.get(client)
            if connections is None:
                connections = self._enter(client)
            connections[connection] = self.stopped[client].pop(connection)
            if not self.stopped[client]:
                del self.stopped[client]
        return bool(found)

    def take(self, may: Callable[[_C, Hashable], bool] = lambda _, __: True) -> tuple[_C, _T]:
        """The client whose turn it is, and its message; connections that may have no turn are stopped.

        Raises IndexError if nothing waits.
        """
        while True:
            account = self._accounts.leave()
            line = self._clients[account]
            client = line.leave()
            connection = self._next_of(client, may)
            if connection is not None:
                break
            self._back(account, line, client)
        client.goes()
        connections = self._there[client]
        items = connections.pop(connection)
        item = items.popleft()
        if items:
            connections[connection] = items  # after the others
        self._count -= 1
        self._back(account, line, client)
        return client, item

    def _next_of(self, client: _C, may: Callable[[_C, Hashable], bool]) -> Hashable | None:
        connections = self._there[client]
        while connections:
            connection = next(iter(connections))
            if may(client, connection):
                return connection
            self.stopped.setdefault(client, {})[connection] = connections.pop(connection)
        return None

    def _back(self, account: Account, line: _Line[_C], client: _C) -> None:
        """Put a client back into line, if more of it waits."""
        if self._there[client]:
            line.join(client)
        else:
            del self._there[client]
        self._account_back(account, line)

    def _account_back(self, account: Account, line: _Line[_C]) -> None:
        if line:
            self._accounts.join(account)
        else:
            del self._clients[account]


def least(clients: Iterable[_C]) -> _C | None:
    """The one that has used least, by account first; of equals, the first. None if there is none."""
    return min(clients, key=lambda client: (client.account.spent, client.spent), default=None)
