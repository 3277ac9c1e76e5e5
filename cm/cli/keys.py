# SPDX-License-Identifier: Apache-2.0
"""Key files of ``cm keygen``: CURVE keys (Z85) as ``name: value`` lines."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cm.errors import CmError, InvalidRequest
from cm.server.rights.keys import FOLDER, OLD_FOLDER, authorized, pairs_of

if TYPE_CHECKING:
    from cm.server.endpoints import Security
    from cm.server.rights.model import AuthorizedKey


class ReadableKey(CmError, PermissionError):
    """A secret key that others than its owner may read."""

    code = "readable_key"


def write_key_file(path: Path, keys: Mapping[str, bytes], comment: str) -> None:
    """Write a new file that only its owner can read. Raises InvalidRequest if it exists."""
    try:
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise InvalidRequest(f"{path} exists already; keys are never overwritten") from None
    with os.fdopen(fd, "w", encoding="ascii") as file:
        file.write(f"# {comment}\n")
        file.writelines(f"{name}: {value.decode()}\n" for name, value in keys.items())


def read_key_file(path: Path) -> dict[str, bytes]:
    """The keys in a file by name."""
    return {name: value.encode() for name, value in pairs_of(path.read_text(encoding="ascii")).items()}


def load_server_keys(path: Path) -> Security:
    """A server's keys. Raises InvalidRequest for another file, ReadableKey for one that others may read."""
    from cm.server.endpoints import Security

    keys = read_key_file(path)
    if not {"public", "secret"} <= keys.keys() or "server-public" in keys:
        raise InvalidRequest(f"{path} is not a server key file; 'cm keygen' makes one")
    status = path.stat()
    if stat.S_IMODE(status.st_mode) & 0o077:
        raise ReadableKey(
            f"{path} can be read or written by others (mode {stat.S_IMODE(status.st_mode):04o}), who could pose as "
            f"this board: chmod 600 {path}, and make new keys if someone may have read it"
        )
    return Security(keys["public"], keys["secret"])


Keys = tuple["AuthorizedKey", ...]


def authorized_keys(server: Path, folder: Path | None) -> tuple[Keys, tuple[str, ...]]:
    """The clients that may connect, and a sentence for each file that was left out.

    Keys lie in ``authorized_keys.d/`` beside the server's, or in `folder`; where there are none, also in ``clients/``
    beside it, as older versions of `cm keygen` wrote them.
    """
    place = folder or server.parent / FOLDER
    found: dict[str, AuthorizedKey] = {}
    left_out = []
    for file in _files(place, server.parent / OLD_FOLDER):
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


def _files(*folders: Path) -> Iterator[Path]:
    for folder in folders:
        yield from sorted(path for path in folder.glob("*.pub") if not path.name.startswith("."))
