# SPDX-License-Identifier: Apache-2.0
"""``cm plan MODE``: what a change of mode would do; nothing is touched."""

from __future__ import annotations

import argparse

from cm.cli.client import connected, plain
from cm.cli.common import add_connection_options, add_json_option, completes, print_json, print_table


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("plan", help="show what a change of mode would do")
    completes(parser.add_argument("mode", metavar="MODE", nargs="?", default=""), "<mode>")
    config = parser.add_argument(
        "--config", default="", metavar="CONFIG", help="configuration to look at (default: the loaded one)"
    )
    completes(config, "<config>")
    add_connection_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the steps; the exit status."""
    with connected(args) as board:
        plan = board.plan(args.mode, args.config)
    if args.json:
        print_json(plain(plan))
        return 0
    if not plan.steps:
        print(f"{plan.config_name}/{plan.mode}: nothing to do, the board is already in this mode")
        return 0
    rows = [
        (i, s.text, s.bytes or "", f"{s.seconds * 1000:.2f}" if s.seconds else "") for i, s in enumerate(plan.steps, 1)
    ]
    print_table(rows, ("", "STEP", "BYTES", "MS"))
    print(f"{plan.config_name}/{plan.mode}: {plan.bytes} bytes to load, about {plan.seconds * 1000:.1f} ms")
    return 0
