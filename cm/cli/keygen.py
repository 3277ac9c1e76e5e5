# SPDX-License-Identifier: Apache-2.0
"""Key files, and ``cm keygen``, which makes them."""

from __future__ import annotations

import argparse
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_json_option, naming, print_json
from cm.errors import CmError, InvalidRequest
from cm.server.rights.keys import FOLDER, OLD_FOLDER, authorized, pairs_of

if TYPE_CHECKING:
    from cm.server.rights.model import AuthorizedKey
    from cm.server.sockets import Security


class ReadableKey(CmError, PermissionError):
    """A secret key that others than its owner may read."""

    code = "readable_key"


def write_key_file(path: Path, keys: Mapping[str, bytes], comment: str) -> None:
    """Write a new file that only its owner can read. Raises InvalidRequest if it exists."""
    try:
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise InvalidRequest(f"{path} exists already; keys are never overwritten") from None
    lines = [f"# {comment}", *(f"{name}: {value.decode()}" for name, value in keys.items()), ""]
    try:
        with naming(path), os.fdopen(fd, "w", encoding="ascii") as file:
            file.write("\n".join(lines))
    except OSError:  # of a full disk: half a file would be in the way of a whole one
        path.unlink()
        raise


def read_key_file(path: Path) -> dict[str, bytes]:
    """The keys in a file by name."""
    return {name: value.encode() for name, value in pairs_of(path.read_text(encoding="ascii")).items()}


def _server_keys(path: Path) -> dict[str, bytes]:
    try:
        keys = read_key_file(path)
    except UnicodeDecodeError:
        keys = {}
    if not {"public", "secret"} <= keys.keys() or "server-public" in keys:
        raise InvalidRequest(f"{path} is not a server key file; 'cm keygen' makes one")
    return keys


def load_server_keys(path: Path) -> Security:
    """A server's keys. Raises InvalidRequest for another file, ReadableKey for one that others may read."""
    from cm.server.sockets import Security

    keys = _server_keys(path)
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


def add_keygen(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "keygen",
        help="make keys for connections over TCP",
        description="Make CURVE keys. The folder holds server.key for 'cm serve --keys' and, for each"
        " client, NAME.key, which you give to the client, and authorized_keys.d/NAME.pub,"
        " by which the server recognises the client and its role. A running manager "
        "notices added and removed keys by itself.",
    )
    parser.add_argument(
        "--role",
        default="provision",
        help="role of the clients: observe, operate, map, provision (default), admin, or one of your own",
    )
    parser.add_argument(
        "--expires", metavar="DAY", default="", help="last day on which the clients' keys are valid, such as 2030-12-31"
    )
    parser.add_argument("folder", metavar="DIR", type=Path)
    parser.add_argument("client", metavar="CLIENT", nargs="*", default=[], help="names of clients to make keys for")
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write key files; the exit status."""
    import zmq

    authorized("", {"public": "0" * 40, "role": args.role, "expires": args.expires})  # refuses what is not a day

    if not zmq.has("curve"):
        raise InvalidRequest("this ZeroMQ library was built without CURVE; keys cannot be made")
    (args.folder / FOLDER).mkdir(mode=0o700, parents=True, exist_ok=True)
    server = args.folder / "server.key"
    if not server.exists():
        public, secret = zmq.curve_keypair()
        write_key_file(server, {"public": public, "secret": secret}, "server: keep it on the board")
        if not args.json:
            print(f"{server}: for cm serve --keys")
    server_public = _server_keys(server)["public"]
    for name in args.client:
        public, secret = zmq.curve_keypair()
        path = args.folder / f"{name}.key"
        keys = {"server-public": server_public, "public": public, "secret": secret}
        write_key_file(path, keys, f"client {name}: for cm.connect(keys=...)")
        said = {"public": public, "role": args.role.encode()}
        if args.expires:
            said["expires"] = args.expires.encode()
        try:
            write_key_file(args.folder / FOLDER / f"{name}.pub", said, f"client {name}")
        except (InvalidRequest, OSError):
            path.unlink()  # one half is in the way of the next try
            raise
        if not args.json:
            print(f"{path}: for the client; cm.connect('tcp://...', keys='{path.name}')")
    if args.json:
        print_json({"server": str(server), "clients": [str(args.folder / f"{name}.key") for name in args.client]})
    return 0
