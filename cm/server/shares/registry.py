# SPDX-License-Identifier: Apache-2.0
"""The budgets of all clients."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from time import monotonic_ns, thread_time_ns
from types import MappingProxyType
from typing import Protocol

from cm.server.shares.bill import Bill, Payer
from cm.server.shares.budget import Bounds, Budget
from cm.server.shares.names import Peer, Who, name_of, place_of
from cm.server.shares.turns import Account, VirtualTime
from cm.wire.messages.status import ClientStatus, LeaseStatus, StreamStatus

_LOOK = 1_000_000  # nanoseconds at least between two checks of what all clients have read,
_REST = 10  # and that many times what the first took: with hundreds of connections, each is asked


class Message(Protocol):
    """What came (`cm.wire.multipart.Message`)."""

    @property
    def connection(self) -> str:
        """Its connection's id, from authentication."""

    @property
    def source(self) -> int:
        """Its connection's descriptor; -1 if that does not matter."""

    @property
    def large(self) -> int:
        """The bytes of its frames that are not small."""


class Budgets:
    """The budgets of all clients, by their names, and the client of each connection."""

    def __init__(
        self,
        bounds: Bounds,
        who: Callable[[str], Who],
        taken: Callable[[int, int], None],
        peers: Callable[[], Iterable[Peer]],
        shares: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """`who` finds clients by the ids of their connections.

        `taken` is told of messages that were received, with the descriptor and the bytes of frames that are not small;
        `peers` returns the open connections. `shares` are those of the loop's time, by the name of a user or a key.
        """
        self._bounds = bounds
        self._who = who
        self._taken = taken
        self._peers = peers
        self._named: dict[str, Budget] = {}
        self.known: dict[str, Budget] = {}  # by connection
        self._accounts: dict[str, Account] = {}
        self._clock = VirtualTime()
        self._shares = shares
        self._next_look = 0  # when, in nanoseconds
        self.queued_bytes = 0  # of messages that wait for their turn
        self.leaving_bytes = 0  # of replies that are being made, or were not read
        self.served: Payer | None = None  # who pays also for what is begun now and done later

    def renew(self, bounds: Bounds, shares: Mapping[str, float]) -> None:
        """Use other bounds and shares from now on; what waits is kept."""
        self._bounds, self._shares = bounds, shares
        for budget in self:
            budget.bounds = bounds
        self.known.clear()  # so that accounts have their new shares
        for account in self._accounts.values():
            account.share = 1.0

    def __iter__(self) -> Iterator[Budget]:
        return iter(self._named.values())

    def came(self, message: Message) -> Budget:
        """The budget of a message's sender; the message counts as received from its connection."""
        if message.source >= 0:
            self._taken(message.source, message.large)
        found = self.known.get(message.connection) or self._admit(message.connection)
        found.requests += 1
        return found

    def of(self, connection: str) -> Budget:
        """The budget of the client that a connection belongs to."""
        return self.known.get(connection) or self._admit(connection)

    @contextmanager
    def bill(self) -> Iterator[Bill]:
        """What is done meanwhile, and what that begins, is charged to the connections that are added."""
        began = monotonic_ns()
        self.served = bill = Bill(self.of)
        try:
            yield bill
        finally:
            self.served = None
            bill.charge(monotonic_ns() - began)

    def _admit(self, connection: str) -> Budget:
        who = self._who(connection)
        found = self.known[connection] = self._named_of(name_of(who), who)
        found.place = f"pid {who.pid}" if who.pid is not None else who.address.removeprefix("::ffff:")
        return found

    def _named_of(self, name: str, who: Who) -> Budget:
        """A client's budget, whatever kind of connection it has."""
        account = self._accounts.get(who.account)
        if account is None:
            account = self._accounts[who.account] = Account(who.account, self._clock)
        account.share = self._shares.get(who.name, 1.0)
        found = self._named.get(name)
        if found is None:
            found = self._named[name] = Budget(name, self._bounds, self, account)
        return found

    def upload_bytes(self) -> int:
        """Of all clients."""
        return sum([budget.upload_bytes for budget in self])

    def waiting_bytes(self) -> int:
        """Of all clients."""
        return sum([budget.waiting_bytes for budget in self])

    def look_at_replies(self) -> None:
        """Count the replies that were read, of all clients, unless that was done just now."""
        if monotonic_ns() >= self._next_look:
            began = thread_time_ns()  # not the wall's: to be preempted is no cost, and would keep clients waiting
            for budget in self:
                budget.look_at_replies()
            self._next_look = monotonic_ns() + max(_LOOK, _REST * (thread_time_ns() - began))

    def settle(self) -> None:
        """Count connections anew, and forget clients that have nothing left."""
        there = Counter(map(place_of, self._peers()))
        for budget in self._named.values():
            budget.connections = there[budget.place]
            budget.look_at_replies()
            budget.forget_connections()
        self._named = {name: budget for name, budget in self._named.items() if not budget.idle}
        self.known = {key: budget for key, budget in self.known.items() if budget.name in self._named}
        used = {budget.account.name for budget in self}
        self._accounts = {name: account for name, account in self._accounts.items() if name in used}

    def snapshot(self) -> tuple[ClientStatus, ...]:
        """What every client uses now; leases and slots are added elsewhere."""
        self.settle()
        return tuple([_told(budget) for _, budget in sorted(self._named.items())])


def with_holdings(
    clients: Iterable[ClientStatus],
    leases: Iterable[LeaseStatus],
    streams: Iterable[StreamStatus],
    memory: Mapping[str, int],
) -> tuple[ClientStatus, ...]:
    """Clients with the leases, the slots of streams and the bytes of `memory` that they hold."""
    held = Counter(lease.client for lease in leases)
    slots = Counter[str]()
    for stream in streams:
        for reader in stream.clients:
            slots[f"pid {reader.pid} ({reader.name})"] += reader.depth
    known = {client.name: client for client in clients}
    for name in ((held | slots).keys() | memory.keys()) - known.keys():
        known[name] = ClientStatus(name)
    return tuple(
        [
            replace(known[name], leases=held[name], slots=slots[name], memory_bytes=memory.get(name, 0))
            for name in sorted(known)
        ]
    )


def _told(budget: Budget) -> ClientStatus:
    return ClientStatus(
        name=budget.name,
        connections=budget.connections,
        upload_bytes=budget.upload_bytes,
        waiting_bytes=budget.waiting_bytes + budget.queued_bytes + budget.unread_bytes,
        unread_bytes=budget.unread_bytes,
        loop_seconds=budget.busy_ns / 1e9,
        requests=budget.requests,
        refused=budget.refused,
        account=budget.account.name,
        waiting=budget.waiting,
    )
