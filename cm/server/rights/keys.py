# SPDX-License-Identifier: Apache-2.0
"""Files of authorized keys: ``name: value`` lines, one file for each client."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone

from cm.errors import InvalidRequest
from cm.server.rights.model import AuthorizedKey

FOLDER = "authorized_keys.d"
OLD_FOLDER = "clients"  # the name in older versions of `cm keygen`
_FIELDS = ("public", "role", "expires")
_DEFAULT = ("provision",)


def pairs_of(text: str) -> dict[str, str]:
    """The lines of a key file that are not comments, by name. Of several with one name the last counts."""
    lines = (line.partition(":") for line in text.splitlines() if line.strip() and not line.startswith("#"))
    return {name.strip(): value.strip() for name, _, value in lines}


def authorized(name: str, pairs: Mapping[str, str]) -> AuthorizedKey:
    """The key of a client. Raises InvalidRequest for what is not a client's public key."""
    public = pairs.get("public", "")
    if "secret" in pairs:
        raise InvalidRequest("it holds a secret key: only NAME.pub belongs here, the .key is the client's alone")
    if len(public) != 40 or not public.isascii() or not public.isprintable():
        raise InvalidRequest("it has no line 'public:' with a key of 40 characters, as 'cm keygen' writes it")
    unknown = [field for field in pairs if field not in _FIELDS]
    if unknown:
        raise InvalidRequest(f"unknown line {unknown[0][:80]!r}; there are {', '.join(_FIELDS)}")
    roles = tuple(role.strip() for role in pairs.get("role", "").split(",") if role.strip()) or _DEFAULT
    return AuthorizedKey(public, name, roles, _until(pairs.get("expires", "")))


def _until(text: str) -> float | None:
    """The end of a day, or a time, in UTC unless it says otherwise; CLOCK_REALTIME seconds."""
    if not text:
        return None
    try:
        when = datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError:
        raise InvalidRequest(f"expires: {text[:80]!r} is not a day such as 2030-12-31, and no time") from None
    if len(text) == len("2030-12-31"):
        when = when.replace(hour=23, minute=59, second=59)
    return (when if when.tzinfo else when.replace(tzinfo=timezone.utc)).timestamp()
