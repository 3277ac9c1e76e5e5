# SPDX-License-Identifier: Apache-2.0
"""``cm irq list|wait``: interrupts by name."""

from __future__ import annotations

import argparse
from itertools import islice

from cm.cli.common import add_board_options, answer, answer_table, completes, natural, seconds
from cm.cli.connection import connected, followed
from cm.wire.messages.json_values import plain


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the interrupts of the loaded configuration")
    add_board_options(listing, run_list)
    wait = actions.add_parser("wait", help="wait for an interrupt")
    completes(wait.add_argument("name", metavar="NAME"), "<interrupt>")
    wait.add_argument("--timeout", type=seconds, metavar="SECONDS", help="give up after this time (exit status 1)")
    wait.add_argument(
        "--count", type=natural, default=1, metavar="N", help="wait for N interrupts (1); 0: until Ctrl-C"
    )
    add_board_options(wait, run_wait)


def run_list(args: argparse.Namespace) -> int:
    """Print names and counts; the exit status."""
    with connected(args) as board:
        found = board.config().interrupts
    rows = [(i.name, i.count, i.doc) for i in found]
    return answer_table(args, [plain(i) for i in found], rows, ("NAME", "COUNT", "MEANING"))


def run_wait(args: argparse.Namespace) -> int:
    """Print each interrupt as it comes; the exit status."""
    with connected(args) as board:
        events = board.interrupts[args.name].events(args.timeout)
        for irq in islice(followed(board, events) if args.timeout is None else events, args.count or None):
            answer(args, plain(irq), f"{irq.name} {irq.count}  {irq.timestamp_ns / 1e9:.6f} s", lines=True)
    return 0
