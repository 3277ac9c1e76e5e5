# SPDX-License-Identifier: Apache-2.0
"""``cm watch``: follow the status as it changes."""

from __future__ import annotations

import argparse
import os
import sys

from cm.cli.client import connected, plain
from cm.cli.common import add_connection_options, add_json_option, natural, print_json
from cm.cli.following import followed
from cm.cli.status import headline, show
from cm.wire.messages.status import Status

_CLEAR = "\x1b[H\x1b[J"  # home, erase below: ECMA-48 CUP and ED


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "watch",
        help="follow the status as it changes",
        description="A live view on a terminal, otherwise one line for each status.",
    )
    add_connection_options(parser)
    add_json_option(parser)
    parser.add_argument("--count", type=natural, default=0, metavar="N", help="stop after N statuses (0: never)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print each status until interrupted; the exit status."""
    once = args.count == 1  # then what was on the screen stays there
    live = sys.stdout.isatty() and (once or os.environ.get("TERM", "dumb") != "dumb")
    with connected(args) as board:
        for number, status in enumerate(followed(board, board.watch()), 1):
            if args.json:
                print_json(plain(status), lines=True)
            elif live:
                print("" if once else _CLEAR, end="")
                show(status)
                sys.stdout.flush()
            else:
                print(_line(status), flush=True)
            if number == args.count:
                break
    return 0


def _line(status: Status) -> str:
    loaded = f"{status.config_name}/{status.mode}" if status.config_name else "-"
    error = f"  {status.last_error.code}: {status.last_error.message}" if status.last_error else ""
    return f"{status.sequence}  {loaded}  {headline(status)}{error}"
