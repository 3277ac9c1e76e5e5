# SPDX-License-Identifier: Apache-2.0
"""Key files: ``name: value`` lines, the server's own, and one of each client that may connect."""

from __future__ import annotations

import stat
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path

from cm.errors import CmError, InvalidRequest
from cm.server.rights.model import AuthorizedKey, Security

FOLDER = "authorized_keys.d"
_FIELDS = ("public", "role", "expires")
_DEFAULT = ("provision",)


class ReadableKey(CmError, PermissionError):
    """A secret key that others than its owner may read."""

    code = "readable_key"


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


def read_key_file(path: Path) -> dict[str, bytes]:
    """The keys in a file by name."""
    return {name: value.encode() for name, value in pairs_of(path.read_text(encoding="ascii")).items()}


def server_keys(path: Path) -> dict[str, bytes]:
    """Those in a server's file. Raises InvalidRequest for another file."""
    try:
        keys = read_key_file(path)
    except UnicodeDecodeError:
        keys = {}
    if not {"public", "secret"} <= keys.keys() or "server-public" in keys:
        raise InvalidRequest(f"{path} is not a server key file; 'cm keygen' makes one")
    return keys


def load_server_keys(path: Path) -> Security:
    """A server's keys. Raises InvalidRequest for another file, ReadableKey for one that others may read."""
    keys = server_keys(path)
    status = path.stat()
    if stat.S_IMODE(status.st_mode) & 0o077:
        raise ReadableKey(
            f"{path} can be read or written by others (mode {stat.S_IMODE(status.st_mode):04o}), who could pose as "
            f"this board: chmod 600 {path}, and make new keys if someone may have read it"
        )
    return Security(keys["public"], keys["secret"])


Keys = tuple[AuthorizedKey, ...]


def authorized_keys(server: Path, folder: Path | None) -> tuple[Keys, tuple[str, ...]]:
    """The clients that may connect, and a sentence for each file that was left out.

    Keys lie in ``authorized_keys.d/`` beside the server's, or in `folder`.
    """
    place = folder or server.parent / FOLDER
    found: dict[str, AuthorizedKey] = {}
    left_out = []
    for file in sorted(path for path in place.glob("*.pub") if not path.name.startswith(".")):
        try:
            key = authorized(file.stem, pairs_of(file.read_text(encoding="ascii")))
        except (InvalidRequest, OSError, UnicodeDecodeError) as error:
            left_out.append(f"{file}: this key is left out: {error}")
            continue
        first = found.setdefault(key.public, key)
        if first is not key and first.name != key.name:
            left_out.append(f"{file}: this key is left out: it is that of {first.name} already")
    if not found:
        left_out.append(f"{place} holds no client's key, so that no client can connect over TCP: 'cm keygen' makes one")
    return tuple(found.values()), tuple(left_out)
