# SPDX-License-Identifier: Apache-2.0
"""Leases: a client holds the board, a configuration, a region or a register, alone or with others.

A lease ends when it is given back, when its time is over, or when its holder's process dies (`drop` is called by the
part that watches processes). Scopes overlap if one contains the other.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Iterable
from itertools import count
from math import inf
from typing import TYPE_CHECKING

from cm.errors import Busy, InvalidRequest, NotFound
from cm.frozen import dataclass, replace
from cm.manager.errors import HeldBy, hint
from cm.schema.model import Config, Mode, Module
from cm.wire.messages.requests import (
    LEASE_SECONDS,
    BreakLease,
    ReleaseLease,
    RenewLease,
    TakeLease,
)
from cm.wire.messages.status import LeaseInfo, LeaseStatus

if TYPE_CHECKING:
    from cm.manager.interfaces import TimeSource


def check_scope_names_something(scope: str, configs: Iterable[Config], memories: Iterable[str]) -> None:
    """Raise NotFound if no served configuration has what a scope names: such a lease would keep no client off.

    `memories`: those that were defined at run time.
    """
    kind, _, name = scope.partition(":")
    if kind not in NAMED or not name:
        return
    known = set(memories) if kind == "memories" else set()
    for config in configs:
        known |= _names(kind, config)
    if name not in known:
        raise NotFound(f"scope {scope!r}: no configuration has {name!r}{hint(name, known)}")


def _names(kind: str, config: Config) -> set[str]:
    """The things of one kind that a configuration has, in any of its modes."""
    if kind == "region":
        return set(config.regions)
    views: list[Config | Mode | Module] = [config, *config.modes.values(), *config.modules.values()]
    return {name for view in views for name in (view.registers if kind == "registers" else view.memories)}


MAX_SECONDS = 3600.0
NAMED = ("region", "registers", "memories")


class TooManyLeases(Busy):
    """A client, or all together, hold as many leases as are allowed."""

    code = "too_many_leases"


class UnknownLease(NotFound):
    """The lease has ended, or never existed."""

    code = "unknown_lease"


@dataclass(frozen=True, slots=True)
class _Lease:
    info: LeaseInfo
    until: float
    number: int
    client: str
    pid: int
    account: str  # the user, or key, whose share it counts in


class Leases:
    """All leases that are held now."""

    def __init__(self, time: TimeSource, most: int = 256, each: int = 32) -> None:
        """`most` may be held at once, `each` by one user, or key."""
        self._time = time
        self._most, self._each = most, each
        self._numbers = count(1)
        self._lock = threading.Lock()  # requests and the worker of changes both ask
        self._held: dict[str, _Lease] = {}
        self._untold = False
        self.on_change: Callable[[], None] = lambda: None  # one was taken or has ended; called without the lock

    def renew(self, most: int, each: int) -> None:
        """Apply other bounds from now on; leases that are held stay."""
        with self._lock:
            self._most, self._each = most, each

    def request(
        self, request: TakeLease | RenewLease | ReleaseLease | BreakLease, client: str = "", account: str = ""
    ) -> LeaseInfo:
        """Take, renew, give back or break. Raises HeldBy, UnknownLease, TooManyLeases, InvalidRequest."""
        try:
            with self._lock:
                self._expire()
                return self._carry_out(request, client, account or client)
        finally:
            self._publish_change()

    def _carry_out(
        self, request: TakeLease | RenewLease | ReleaseLease | BreakLease, client: str, account: str
    ) -> LeaseInfo:
        if isinstance(request, ReleaseLease):
            return self._lease_of(request.id, remove=True).info
        if isinstance(request, BreakLease):
            for key, held in self._held.items():
                if held.number == request.number:
                    return self._lease_of(key, remove=True).info
            raise UnknownLease(f"no lease has the number {request.number}; cm lease list")
        seconds = request.seconds or LEASE_SECONDS
        if not 0 < seconds <= MAX_SECONDS:
            raise InvalidRequest(f"a lease of {seconds} s: it can be held for up to {MAX_SECONDS:.0f} s, then renewed")
        if isinstance(request, TakeLease):
            return self._new(request, seconds, client, account)
        held = self._lease_of(request.id, remove=False)
        info = replace(held.info, seconds=seconds)
        self._held[request.id] = replace(held, info=info, until=self._time.monotonic() + seconds)
        return info

    def expire(self) -> float | None:
        """End those whose time is over; seconds until that of the next one, None where none is held."""
        with self._lock:
            self._expire()
            left = min((self._seconds_left(held) for held in self._held.values() if held.until < inf), default=None)
        self._publish_change()
        return left

    def _publish_change(self) -> None:
        if self._untold:
            self._untold = False
            self.on_change()

    def check(self, scopes: tuple[str, ...], lease: str = "") -> None:
        """Raise HeldBy where another's lease forbids any of these scopes; `lease`: ids of one's own, between commas."""
        if not self._held:
            return
        with self._lock:
            self._expire()
            self._check(scopes, lease)

    @property
    def any_held(self) -> bool:
        """Whether one is held; it may have ended a moment ago."""
        return bool(self._held)

    def _check(self, scopes: tuple[str, ...], lease: str) -> None:
        own = [self._held[key] for key in lease.split(",") if key in self._held]
        for held in self._held.values():
            shared = not held.info.exclusive and any(_overlap(one.info.scope, held.info.scope) for one in own)
            if held not in own and not shared and any(_overlap(held.info.scope, scope) for scope in scopes):
                raise HeldBy(_held_by(held, self._seconds_left(held)))

    def holds(self, lease: str) -> bool:
        """Whether a lease has not ended."""
        with self._lock:
            self._expire()
            return lease in self._held

    def held(self) -> tuple[LeaseInfo, ...]:
        """The leases that have not ended, oldest first."""
        with self._lock:
            self._expire()
            return tuple(lease.info for lease in self._held.values())

    def statuses(self) -> tuple[LeaseStatus, ...]:
        """The same, as all clients may see them."""
        if not self._held:
            return ()
        with self._lock:
            self._expire()
            return tuple(
                LeaseStatus(
                    x.number, x.info.scope, x.info.exclusive, x.info.holder, x.client, x.pid,
                    self._seconds_left(x) if x.until < inf else 0.0,
                )
                for x in self._held.values()
            )  # fmt: skip

    def hold(self, scope: str, holder: str, client: str, pid: int) -> str:
        """Take one that has no end but `drop`, or being broken; returns its id. Raises HeldBy, TooManyLeases."""
        taken = self.request(TakeLease(scope, True, seconds=MAX_SECONDS, holder=holder, pid=pid), client)
        with self._lock:
            self._held[taken.id] = replace(self._held[taken.id], until=inf)
        return taken.id

    def drop(self, lease: str) -> bool:
        """End a lease whose holder has died."""
        with self._lock:
            there = self._held.pop(lease, None) is not None
            self._untold |= there
        self._publish_change()
        return there

    def _new(self, request: TakeLease, seconds: float, client: str, account: str) -> LeaseInfo:
        scope, (kind, _, name) = request.scope, request.scope.partition(":")
        if not (name if kind in NAMED else scope in ("board", "config")):
            raise InvalidRequest(
                f"scope {scope!r}: it is one of board, config, region:NAME, registers:NAME, memories:NAME"
            )
        own = sum(held.account == account for held in self._held.values())
        if own >= self._each or len(self._held) >= self._most:
            raise TooManyLeases(
                f"{account or 'this client'} holds {own} leases, all together {len(self._held)}; "
                f"{self._each} and {self._most} may be held (limits.leases)"
            )
        for held in self._held.values():
            alone = request.exclusive or held.info.exclusive
            if alone and _overlap(held.info.scope, scope):
                raise HeldBy(_held_by(held, self._seconds_left(held)))
        holder = "".join(c if c.isprintable() else "?" for c in request.holder) or "somebody"  # safe for a log
        info = LeaseInfo(os.urandom(8).hex(), scope, request.exclusive, seconds, holder)
        until = self._time.monotonic() + seconds
        self._held[info.id] = _Lease(info, until, next(self._numbers), client, request.pid, account)
        self._untold = True
        return info

    def _lease_of(self, lease: str, remove: bool) -> _Lease:
        held = self._held.get(lease)
        if held is None:
            raise UnknownLease(f"no lease {lease!r} is held; it may have ended after its time")
        if remove:
            del self._held[lease]
            self._untold = True
        return held

    def _expire(self) -> None:
        now = self._time.monotonic()
        held = {k: x for k, x in self._held.items() if x.until > now}
        self._untold |= len(held) < len(self._held)
        self._held = held

    def _seconds_left(self, held: _Lease) -> float:
        return max(0.0, held.until - self._time.monotonic())


def leases_concerned(config: Config, mode: str, loaded: str | None, unloaded: Collection[str] = ()) -> tuple[str, ...]:
    """What a change to a mode touches, or one to no mode that unloads regions, as scopes.

    Within a configuration: its regions, the registers that it writes or resets, and memories in its regions. To
    another one, or with a full image: everything. A lease on the configuration or the board covers every change.
    """
    if config.name != loaded:
        return ("config",)
    modes = (mode,) if mode else config.modes
    regions = {config.modules[m].region for m in config.modes[mode].modules} if mode else set(unloaded)
    registers = {r.name: r for name in modes for r in config.visible_registers(name).values()}
    names = (r.name for r in registers.values() if r.region in regions or (mode and r.default is not None))
    seen = {m.name: m for name in modes for m in config.visible_memories(name).values()}
    memories = (m.name for m in seen.values() if m.region in regions)
    return (
        "mode",
        *(f"region:{name}" for name in sorted(regions)),
        *(f"registers:{name}" for name in names),
        *(f"memories:{name}" for name in memories),
    )


def _overlap(a: str, b: str) -> bool:
    return a == b or "board" in (a, b) or "config" in (a, b)


def _held_by(held: _Lease, left: float) -> str:
    info = held.info
    how = "alone" if info.exclusive else "shared"
    long = f"for {left:.0f} s more unless renewed" if left < inf else "until that is given back"
    out = f"CM_LEASE=ID (lease=ID in Python) if it is yours; cm lease break {held.number} ends it (for administrators)"
    return f"{info.scope} is held by {info.holder} ({how}), {long}; {out}"
