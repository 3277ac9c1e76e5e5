# SPDX-License-Identifier: Apache-2.0
"""Roles, what narrows them, and who has which: what an administrator says, as data."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from fnmatch import fnmatchcase
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.frozen import dataclass, field, replace

ALL = ("*",)


class Role(IntEnum):
    """Each may do what those before it may."""

    NONE = 0
    OBSERVE = 1  # look at all that the board holds and tells
    OPERATE = 2  # change modes, registers, streams and memories; take leases
    MAP = 3  # map registers: nobody sees what is read and written there, nor checks it
    PROVISION = 4  # send configurations, remove one's own, define memories
    ADMIN = 5  # take away leases and configurations of others; speak for others


@dataclass(frozen=True, slots=True)
class Security:
    """CURVE keys of the server (Z85, 40 characters)."""

    public_key: bytes
    secret_key: bytes


@dataclass(frozen=True, slots=True)
class Need:
    """One thing that a request touches; None where it touches nothing of that kind, ``*`` where all."""

    role: Role
    topic: str
    config: str | None = None
    region: str | None = None
    register: str | None = None  # or register.field
    data: str | None = None  # a stream, or a memory


@dataclass(frozen=True, slots=True)
class Grant:
    """A role for what matches all of these patterns (``*``, ``?``, ``[…]``)."""

    role: Role
    topics: tuple[str, ...] = ALL
    configs: tuple[str, ...] = ALL
    regions: tuple[str, ...] = ALL
    registers: tuple[str, ...] = ALL
    data: tuple[str, ...] = ALL
    guests: tuple[str, ...] = ()  # names that its holder may speak for

    def allows(self, need: Need) -> bool:
        """Whether this grant alone is enough."""
        register = need.register and need.register.partition(".")[0]
        return (
            self.role >= need.role
            and _match(need.topic, self.topics)
            and _match(need.config, self.configs)
            and _match(need.region, self.regions)
            and (_match(need.register, self.registers) or _match(register, self.registers))
            and _match(need.data, self.data)
        )


def _match(name: str | None, patterns: tuple[str, ...]) -> bool:
    """A name, nothing, or everything: that is allowed only where everything is, and not by a pattern such as ``?``."""
    if name is None or "*" in patterns:
        return True
    return name != "*" and any(fnmatchcase(name, pattern) for pattern in patterns)


@dataclass(frozen=True, slots=True)
class Rights:
    """What a client may do: whatever one of the grants allows. `until`: CLOCK_REALTIME seconds.

    `under`: further rights that must allow it too: those of the bridge that speaks for the client.
    """

    grants: tuple[Grant, ...] = ()
    until: float | None = None
    under: Rights | None = None

    @property
    def role(self) -> Role:
        """The highest role, however limited."""
        own = max((grant.role for grant in self.grants), default=Role.NONE)
        return min(own, self.under.role) if self.under else own

    @property
    def everywhere(self) -> Role:
        """The highest role without limits."""
        own = max(
            (grant.role for grant in self.grants if replace(grant, guests=()) == Grant(grant.role)), default=Role.NONE
        )
        return min(own, self.under.everywhere) if self.under else own

    def speaks_for(self, name: str) -> bool:
        """Whether a bridge with these rights may speak for the guest of that name."""
        return any(grant.role >= Role.ADMIN or any(fnmatchcase(name, p) for p in grant.guests) for grant in self.grants)

    def allow(self, need: Need) -> bool:
        """Whether one thing may be done."""
        return any(grant.allows(need) for grant in self.grants) and (self.under is None or self.under.allow(need))


@dataclass(frozen=True, slots=True)
class AuthorizedKey:
    """A client's public key (Z85), and what its holder may do."""

    public: str
    name: str
    roles: tuple[str, ...] = ("provision",)
    until: float | None = None  # CLOCK_REALTIME seconds


def empty() -> Mapping[str, Any]:
    """The default of mappings."""
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Access:
    """Who has which roles.

    `roles` are limited ones, with names of their own; lists of roles add up. `group` owns the sockets of the runtime
    folder; `local` is for all users that can connect to them and are not named; the manager's own user and root are
    always admin. `insecure`: for clients over TCP without keys. `guests`: for those that a bridge speaks for, by name
    or pattern; ``*`` for all others. `keys` are those in `keys_folder`, or else beside the server's.
    """

    group: str = ""
    local: tuple[str, ...] = ("provision",)
    insecure: tuple[str, ...] = ("provision",)
    users: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    guests: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    roles: Mapping[str, Grant] = field(default_factory=empty)
    keys: tuple[AuthorizedKey, ...] = ()
    keys_folder: Path | None = None

    @property
    def names(self) -> frozenset[str]:
        """The names of all roles."""
        return frozenset((*(role.name.lower() for role in Role if role), *self.roles))
