# SPDX-License-Identifier: Apache-2.0
"""``cm fleet keys`` and ``cm fleet router``: certificates of a fleet with the router's rules, and that router."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from cm.cli.common import digits, parsed, print_table

PORT = 7447


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions."""
    _add_router(actions)
    port = parsed("a port from 1 to 65535", digits, lambda number: 0 < number < 1 << 16)
    days = parsed("a number of days from 1 to 36500", digits, lambda number: 0 < number <= 36500)
    word = parsed("a name", str, bool)
    keys = actions.add_parser("keys", help="make certificates, and the router's rules for them")
    keys.add_argument("folder", type=Path, metavar="DIR", help="folder of the fleet's authority; keep it safe")
    kinds = keys.add_subparsers(dest="kind", metavar="WHOSE", required=True)
    router = kinds.add_parser(
        "router", help="begin with this: make the authority, and the router's file; later, renew its certificate"
    )
    router.add_argument(
        "--host",
        action="append",
        default=[],
        type=word,
        metavar="NAME",
        help="a name or address by which the router is reached; those that it has stay, and boards use the first",
    )
    router.add_argument("--port", type=port, help=f"port of the router ({PORT})")
    router.add_argument(
        "--store", default="", metavar="WHERE", help="where the wanted state is, if that is etcd: its URLs"
    )
    board = kinds.add_parser("board", help="make a file for a board's bridge")
    board.add_argument("--keeper", action="store_true", help="it may keep the fleet's wanted state")
    client = kinds.add_parser("client", help="make a file for a user of the fleet")
    client.add_argument("--role", default="observe", help="observe, operate or provision (observe)")
    client.add_argument("--boards", action="append", default=[], metavar="NAME", help="only these (default: all)")
    remove = kinds.add_parser("remove", help="remove a member and its rights")
    for parser in (board, client, remove):
        parser.add_argument("name", metavar="NAME")
    for parser in (router, board, client):
        parser.add_argument(
            "--days", type=days, default=825, metavar="N", help="days for which the certificate is valid (825)"
        )
    kinds.add_parser("list", help="list who has a certificate")
    keys.set_defaults(run=run)


def _add_router(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser("router", help="run a zenoh router in this process, for machines without zenohd")
    parser.add_argument(
        "--listen",
        action="append",
        default=[],
        metavar="HOST:PORT",
        help=f"address to listen on (127.0.0.1:{PORT}: without certificates, whoever reaches it is anybody)",
    )
    parser.add_argument("--zenoh-config", type=Path, metavar="FILE", help="router.json5 of `cm fleet keys`")
    parser.set_defaults(run=run_router)


def run_router(args: argparse.Namespace) -> int:
    """Route until interrupted; the exit status."""
    from cm.networks.fleet.zenoh_session import Network, endpoint, session

    listen = tuple(map(endpoint, args.listen))
    if not listen and args.zenoh_config is None:
        listen = (endpoint("127.0.0.1"),)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit(0))
    with session(Network("router", (), listen, args.zenoh_config)):
        print("cm fleet router: ready", file=sys.stderr, flush=True)
        while True:
            signal.pause()


def run(args: argparse.Namespace) -> int:
    """Make, remove or list; the exit status."""
    from cm.networks.fleet.security.access_rules import ALL_BOARDS, Member
    from cm.networks.fleet.security.keys_folder import KeyFolder

    keys = KeyFolder(args.folder)
    if args.kind == "list":
        rows = [(m.name, m.kind, m.role if m.kind == "client" else "", _boards(m)) for m in keys.members()]
        print_table(rows, ("NAME", "KIND", "ROLE", "BOARDS"))
        return 0
    if args.kind == "remove":
        keys.remove(args.name)
        print(f"{args.name} has no rights any more, once the router is started anew with {args.folder}/router.json5")
        return 0
    if args.kind == "router":
        path = keys.router(tuple(args.host), args.days, args.port, args.store)
        print(f"{path}: for the router (`zenohd -c {path.name}`, or `cm fleet router --zenoh-config {path.name}`)")
        return 0
    client = args.kind == "client"
    boards = tuple(args.boards) if client and args.boards else ALL_BOARDS
    member = Member(
        args.name, args.kind, args.role if client else "observe", boards, args.kind == "board" and args.keeper
    )
    path = keys.add(member, args.days)
    option = "cm bridge fleet" if args.kind == "board" else "cm fleet …"
    print(f"{path}: for `{option} --zenoh-config {path.name}`; whoever has this file is {args.name}")
    if client and args.role != "observe":
        print(f'cm.yaml of the boards: access.guests: {{"zenoh:{args.name}": {args.role}}}')
    print(f"the router takes its new rules from {args.folder}/router.json5 when it is started anew")
    return 0


def _boards(member: object) -> str:
    boards = getattr(member, "boards", ())
    return "" if getattr(member, "kind", "") != "client" else "all" if boards == ("*",) else " ".join(boards)
