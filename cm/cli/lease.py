# SPDX-License-Identifier: Apache-2.0
"""``cm lease list|break``: list leases, and end those of others."""

from __future__ import annotations

import argparse

from cm.cli.client import connected, plain
from cm.cli.common import add_connection_options, add_json_option, print_json, print_table


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("lease", help="list leases and break them")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the leases, who holds them and for how long")
    listing.set_defaults(run=run_list)
    breaking = actions.add_parser("break", help="end somebody else's lease (for administrators)")
    breaking.add_argument("number", metavar="NUMBER", type=int, help="number of the lease in the list")
    breaking.set_defaults(run=run_break)
    for action in (listing, breaking):
        add_connection_options(action)
        add_json_option(action)


def run_list(args: argparse.Namespace) -> int:
    """Print the leases; the exit status."""
    with connected(args) as board:
        held = board.status.leases
    if args.json:
        print_json([plain(lease) for lease in held])
    else:
        rows = [
            (x.number, x.scope, "alone" if x.exclusive else "shared", x.holder, x.client, f"{x.seconds:.0f} s")
            for x in held
        ]
        print_table(rows, ("NUMBER", "SCOPE", "HOW", "HOLDER", "CLIENT", "LEFT"))
    return 0


def run_break(args: argparse.Namespace) -> int:
    """End a lease; the exit status."""
    with connected(args) as board:
        ended = board.break_lease(args.number)
    if args.json:
        print_json(plain(ended))
    else:
        print(f"{ended.scope} is held no more by {ended.holder}")
    return 0
