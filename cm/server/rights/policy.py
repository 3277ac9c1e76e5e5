# SPDX-License-Identifier: Apache-2.0
"""The policy: from a principal to its rights. Pure; `Users` says what the system knows of users and groups."""

from __future__ import annotations

import grp
import os
import pwd
from collections.abc import Callable, Iterable
from contextlib import suppress
from fnmatch import fnmatchcase

from cm.frozen import dataclass, replace
from cm.server.rights.model import Access, Grant, Rights, Role
from cm.server.rights.principal import CURVE, DATA, IPC, TCP, Principal

NOTHING = Rights()
_OF_ROLES = {role.name.lower(): Grant(role) for role in Role}
_ADMIN = Rights((Grant(Role.ADMIN),))


@dataclass(frozen=True, slots=True)
class Users:
    """The system's users: `name` of a uid, `groups` (names) of a uid and its process's gid; `own` is ours."""

    name: Callable[[int], str]
    groups: Callable[[int, int], tuple[str, ...]]
    own: int


def known_as(principal: Principal, access: Access, users: Users) -> Principal:
    """The principal with the name by which people know it."""
    if principal.via or principal.name:
        return principal
    if principal.uid is not None:
        return replace(principal, name=users.name(principal.uid))
    if principal.key:
        return replace(principal, name=next((k.name for k in access.keys if k.public == principal.key), ""))
    return principal


def rights_of(principal: Principal, access: Access, users: Users) -> Rights:
    """What a client may do: nothing if it is not known."""
    if principal.transport in (IPC, DATA) and principal.uid is not None:
        return _of_user(principal, access, users)
    if principal.transport == CURVE:
        key = next((k for k in access.keys if k.public == principal.key), None)
        return Rights(grants(key.roles, access), key.until) if key else NOTHING
    if principal.transport == TCP:
        return Rights(grants(access.insecure, access))
    return NOTHING


def _of_user(principal: Principal, access: Access, users: Users) -> Rights:
    """A user that is named, or whose group is, has the roles given there; all others have those of `local`."""
    assert principal.uid is not None
    assert principal.gid is not None
    if principal.uid in (0, users.own):
        return _ADMIN
    named: list[str] = [*access.users.get(str(principal.uid), ())]
    known = str(principal.uid) in access.users
    name = users.name(principal.uid)
    if name and name in access.users:
        named, known = [*named, *access.users[name]], True
    if access.groups:
        for group in users.groups(principal.uid, principal.gid):
            if group in access.groups:
                named, known = [*named, *access.groups[group]], True
    return Rights(grants(named if known else access.local, access))


def of_guest(name: str, bridge: Rights, access: Access) -> Rights:
    """The rights of a guest: those that `guests` gives to the name, and no more than those of the bridge.

    A name counts before patterns such as ``zenoh:*``, and a longer pattern before shorter ones.
    """
    said = access.guests.get(name)
    if said is None:
        fitting = [pattern for pattern in access.guests if "*" in pattern and fnmatchcase(name, pattern)]
        said = access.guests[max(fitting, key=len)] if fitting else ()
    return Rights(grants(said, access), bridge.until, bridge)


def grants(roles: Iterable[str], access: Access) -> tuple[Grant, ...]:
    """The grants of roles by name; names of no role give no grant (settings refuse them beforehand)."""
    known = {**_OF_ROLES, **access.roles}
    return tuple(known[name] for name in roles if name in known and known[name].role > Role.NONE)


def system_users() -> Users:
    """The users of this machine, looked up at each call."""
    return Users(_name, _groups, os.geteuid())


def _name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:  # a user of a container, or one that was deleted
        return ""


def _groups(uid: int, gid: int) -> tuple[str, ...]:
    """The process's groups, and those that the user is a member of."""
    numbers = [gid]
    name = _name(uid)
    if name:
        numbers += [number for number in os.getgrouplist(name, gid) if number != gid]
    found = [str(number) for number in numbers]
    for number in numbers:
        with suppress(KeyError):
            found.append(grp.getgrgid(number).gr_name)
    return tuple(found)
