# SPDX-License-Identifier: Apache-2.0
"""``access`` of the settings: who may do what, from plain values to data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.schema.problems import KeyPath, did_you_mean
from cm.server.rights.model import Grant, Role, role_named
from cm.server.settings.model import AccessSettings

_PEOPLE = ("users", "groups", "guests")
_LISTS = ("local", "insecure")


def access(values: Mapping[str, Any]) -> AccessSettings:
    """The data for values that have been checked against the schema."""
    known = dict(values)
    if "keys" in known:
        known["keys"] = Path(known["keys"])
    known |= {name: tuple(known[name]) for name in _LISTS if name in known}
    for name in (name for name in _PEOPLE if name in known):
        known[name] = MappingProxyType({who: tuple(roles) for who, roles in known[name].items()})
    if "roles" in known:
        known["roles"] = MappingProxyType({name: _grant(said) for name, said in known["roles"].items()})
    return AccessSettings(**known)


def _grant(said: Mapping[str, Any]) -> Grant:
    patterns = {name: tuple(found) for name, found in said.items() if name != "role"}
    return Grant(role_named(said["role"]), **patterns)


def unknown_roles(values: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str, str]]:
    """Names of roles that do not exist: where they stand, and what may have been meant."""
    known = {*(role.name.lower() for role in Role if role), *values.get("roles", ())}
    for path, roles in _named(values):
        for index, role in enumerate(roles):
            if role not in known:
                yield ("access", *path, index), f"no role {role!r}", did_you_mean(role, sorted(known))


def _named(values: Mapping[str, Any]) -> Iterator[tuple[KeyPath, list[str]]]:
    for name in _LISTS:
        yield (name,), values.get(name, [])
    for name in _PEOPLE:
        for who, roles in values.get(name, {}).items():
            yield (name, who), roles
