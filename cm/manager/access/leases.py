# SPDX-License-Identifier: Apache-2.0
"""Leases: a client holds the board, a configuration, a region or a register, alone or with others.

A lease ends when it is given back, when its time is over, or when its holder's process dies (told by
the part that watches processes). Scopes overlap where one contains the other.
"""

from __future__ import annotations

import secrets
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches

from cm.errors import InvalidRequest, NotFound
from cm.manager.errors import HeldBy
from cm.manager.ports import TimeSource
from cm.messages.requests import (
    ConfigureStream,
    ReleaseLease,
    RenewLease,
    Request,
    TakeLease,
    WriteData,
    WriteReg,
)
from cm.messages.status import LeaseInfo
from cm.schema.model import Config, Memory, Mode, Module

MAX_SECONDS = 3600.0
_NAMED = ("region", "registers", "memories")
_KINDS = ("board", "config", *_NAMED)


class UnknownLease(NotFound):
    """The lease has ended, or never was."""

    code = "unknown_lease"


@dataclass(frozen=True, slots=True)
class _Lease:
    info: LeaseInfo
    until: float


class Leases:
    """All leases that are held now."""

    def __init__(self, time: TimeSource) -> None:
        self._time = time
        self._lock = threading.Lock()  # requests and the worker of changes both ask
        self._held: dict[str, _Lease] = {}

    def request(self, request: TakeLease | RenewLease | ReleaseLease) -> LeaseInfo:
        """Take, renew or give back. Raises HeldBy, UnknownLease, InvalidRequest."""
        with self._lock:
            self._expire()
            if isinstance(request, ReleaseLease):
                return self._take(request.id, remove=True).info
            seconds = _checked_seconds(request.seconds)
            return self._renew(request.id, seconds) if isinstance(request, RenewLease) else self._new(request, seconds)

    def check(self, scopes: tuple[str, ...], lease: str = "") -> None:
        """Raise HeldBy where another's lease forbids any of these scopes; `lease`: ids of one's own, between commas."""
        if not self._held:
            return
        with self._lock:
            self._expire()
            self._check(scopes, lease)

    def _check(self, scopes: tuple[str, ...], lease: str) -> None:
        own = [self._held[key] for key in lease.split(",") if key in self._held]
        for held in self._held.values():
            shared = not held.info.exclusive and any(_overlap(one.info.scope, held.info.scope) for one in own)
            if held not in own and not shared and any(_overlap(held.info.scope, scope) for scope in scopes):
                raise HeldBy(_held_by(held.info, self._left(held)))

    def holds(self, lease: str) -> bool:
        """Whether a lease has not ended."""
        with self._lock:
            self._expire()
            return lease in self._held

    def held(self) -> tuple[LeaseInfo, ...]:
        """Those that have not ended, oldest first."""
        with self._lock:
            self._expire()
            return tuple(lease.info for lease in self._held.values())

    def drop(self, lease: str) -> bool:
        """End a lease whose holder has died."""
        with self._lock:
            return self._held.pop(lease, None) is not None

    def _new(self, request: TakeLease, seconds: float) -> LeaseInfo:
        _checked_scope(request.scope)
        for held in self._held.values():
            alone = request.exclusive or held.info.exclusive
            if alone and _overlap(held.info.scope, request.scope):
                raise HeldBy(_held_by(held.info, self._left(held)))
        info = LeaseInfo(secrets.token_hex(8), request.scope, request.exclusive, seconds, request.holder or "somebody")
        self._held[info.id] = _Lease(info, self._time.monotonic() + seconds)
        return info

    def _renew(self, lease: str, seconds: float) -> LeaseInfo:
        held = self._take(lease, remove=False)
        info = replace(held.info, seconds=seconds)
        self._held[lease] = _Lease(info, self._time.monotonic() + seconds)
        return info

    def _take(self, lease: str, remove: bool) -> _Lease:
        held = self._held.get(lease)
        if held is None:
            raise UnknownLease(f"no lease {lease!r} is held; it may have ended after its time")
        if remove:
            del self._held[lease]
        return held

    def _expire(self) -> None:
        now = self._time.monotonic()
        self._held = {k: x for k, x in self._held.items() if x.until > now}

    def _left(self, held: _Lease) -> float:
        return max(0.0, held.until - self._time.monotonic())


def leases_concerned(config: Config, mode: str, loaded: str | None) -> tuple[str, ...]:
    """What a change to a mode touches, as scopes.

    Within a configuration: its regions, the registers that it writes or resets, and memories in its regions. To
    another one, or with a whole image: everything. A lease on the configuration or the board covers every change.
    """
    if config.name != loaded:
        return ("config",)
    regions = {config.modules[m].region for m in config.modes[mode].modules}
    registers = config.visible_registers(mode).values()
    names = (r.name for r in registers if r.region in regions or r.default is not None)
    memories = (m.name for m in config.visible_memories(mode).values() if m.region in regions)
    return (
        "mode",
        *(f"region:{name}" for name in sorted(regions)),
        *(f"registers:{name}" for name in names),
        *(f"memories:{name}" for name in memories),
    )


def scopes_written(request: Request, config: Config | None, mode: str | None, memory: Memory | None) -> Iterator[str]:
    """What a request writes, as `leases_concerned` names it; `memory`: that of the name in it."""
    if isinstance(request, WriteReg):
        visible = config.visible_registers(mode) if config else {}
        for name in {write.name.partition(".")[0] for write in request.writes}:
            yield f"registers:{name}"
            yield f"region:{visible[name].region if name in visible else None}"
    elif isinstance(request, (WriteData, ConfigureStream)):
        what = memory or (config.streams.get(request.stream) if config else None)
        yield f"memories:{request.stream}"
        yield f"region:{what.region if what else None}"


def check_scope_names_something(scope: str, configs: Iterable[Config], memories: Iterable[str]) -> None:
    """Raise NotFound where no served configuration has what a scope names: such a lease would keep no client off.

    `memories`: those that were defined at run time.
    """
    kind, _, name = scope.partition(":")
    if kind not in _NAMED or not name:
        return
    known = set(memories) if kind == "memories" else set()
    for config in configs:
        known |= _named(kind, config)
    if name not in known:
        close = get_close_matches(name, known, 1)
        there = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(sorted(known)) or 'none'}"
        raise NotFound(f"scope {scope!r}: no configuration has {name!r}; {there}")


def _named(kind: str, config: Config) -> set[str]:
    """What one configuration has of a kind, in whatever mode."""
    if kind == "region":
        return set(config.regions)
    views: list[Config | Mode | Module] = [config, *config.modes.values(), *config.modules.values()]
    return {name for view in views for name in (view.registers if kind == "registers" else view.memories)}


def _checked_seconds(seconds: float) -> float:
    """How long a lease is held; 30 s where nothing is said. Raises InvalidRequest."""
    seconds = seconds or 30.0
    if not 0 < seconds <= MAX_SECONDS:
        raise InvalidRequest(f"a lease of {seconds} s: it can be held for up to {MAX_SECONDS:.0f} s, then renewed")
    return seconds


def _checked_scope(scope: str) -> None:
    kind, colon, name = scope.partition(":")
    if kind not in _KINDS or (kind in _NAMED) != bool(colon and name):
        raise InvalidRequest(f"scope {scope!r}: it is one of board, config, region:NAME, registers:NAME, memories:NAME")


def _overlap(a: str, b: str) -> bool:
    return a == b or "board" in (a, b) or "config" in (a, b)


def _held_by(info: LeaseInfo, left: float) -> str:
    how = "alone" if info.exclusive else "shared"
    return f"{info.scope} is held by {info.holder} ({how}), for {left:.0f} s more unless renewed"
