# SPDX-License-Identifier: Apache-2.0
"""Users and groups, as the system knows them."""

from __future__ import annotations

import grp
import os
import pwd
from contextlib import suppress

from cm.server.rights.policy import Users


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
