# SPDX-License-Identifier: Apache-2.0
"""``cm irq list|wait``: interrupts by name."""

from __future__ import annotations

import argparse
from itertools import islice

from cm.cli.common import add_connection_options, add_json_option, completes, natural, print_json, print_table, seconds
from cm.cli.connection import connected, followed, plain


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("irq", help="list interrupts and wait for them")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the interrupts of the loaded configuration")
    listing.set_defaults(run=run_list)
    wait = actions.add_parser("wait", help="wait for an interrupt")
    completes(wait.add_argument("name", metavar="NAME"), "<interrupt>")
    wait.add_argument("--timeout", type=seconds, metavar="SECONDS", help="give up after this time (exit status 1)")
    wait.add_argument("--count", type=natural, default=1, metavar="N", help="wait for N interrupts; 0: until Ctrl-C")
    wait.set_defaults(run=run_wait)
    for action in (listing, wait):
        add_connection_options(action)
        add_json_option(action)


def run_list(args: argparse.Namespace) -> int:
    """Print names and counts; the exit status."""
    with connected(args) as board:
        found = board.config().interrupts
    if args.json:
        print_json([plain(i) for i in found])
    else:
        print_table([(i.name, i.count, i.doc) for i in found], ("NAME", "COUNT", "MEANING"))
    return 0


def run_wait(args: argparse.Namespace) -> int:
    """Print each interrupt as it comes; the exit status."""
    with connected(args) as board:
        events = board.interrupts[args.name].events(args.timeout)
        for irq in islice(followed(board, events) if args.timeout is None else events, args.count or None):
            if args.json:
                print_json(plain(irq), lines=True)
            else:
                print(f"{irq.name} {irq.count}  {irq.timestamp_ns / 1e9:.6f} s", flush=True)
    return 0
