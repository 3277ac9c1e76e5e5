# SPDX-License-Identifier: Apache-2.0
"""Key files of ``cm keygen``: CURVE keys (Z85) as ``name: value`` lines."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from cm.errors import InvalidRequest

if TYPE_CHECKING:
    from cm.daemon.endpoints import Security


def write_key_file(path: Path, keys: dict[str, bytes], comment: str) -> None:
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
    lines = path.read_text(encoding="ascii").splitlines()
    pairs = (line.partition(":") for line in lines if line and not line.startswith("#"))
    return {name.strip(): value.strip().encode() for name, _, value in pairs}


def load_server_keys(path: Path) -> Security:
    """A server's keys, and the public keys of the clients it lets in (``*.pub`` in ``clients/`` beside the file)."""
    from cm.daemon.endpoints import Security

    keys = read_key_file(path)
    if not {"public", "secret"} <= keys.keys() or "server-public" in keys:
        raise InvalidRequest(f"{path} is no server key file; 'cm keygen server' makes one")
    clients = sorted((path.parent / "clients").glob("*.pub"))
    allowed = frozenset(read_key_file(c)["public"] for c in clients)
    if not allowed:
        raise InvalidRequest(f"{path.parent / 'clients'} holds no client's .pub file, so nobody could connect")
    return Security(keys["public"], keys["secret"], allowed)
