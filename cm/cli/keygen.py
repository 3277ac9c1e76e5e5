# SPDX-License-Identifier: Apache-2.0
"""``cm keygen``: makes key files."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path

from cm.cli.common import add_json_option, naming, print_json
from cm.errors import InvalidRequest
from cm.server.rights.keys import FOLDER, authorized, server_keys


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


def add_keygen(parser: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser.description = (
        "Make CURVE keys. The folder holds server.key for 'cm serve --keys' and, for each"
        " client, NAME.key, which you give to the client, and authorized_keys.d/NAME.pub,"
        " by which the server recognises the client and its role. A running manager "
        "notices added and removed keys by itself."
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
    add_json_option(parser, run)


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
    server_public = server_keys(server)["public"]
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
