# SPDX-License-Identifier: Apache-2.0
"""``cm configs``: the configurations and their modes; ``cm configs --send``: provision one."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.client import connected, plain
from cm.cli.common import add_connection_options, add_json_option, print_json, print_table


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("configs", help="list the configurations and their modes")
    add_connection_options(parser)
    add_json_option(parser)
    parser.add_argument(
        "--send",
        nargs="+",
        type=Path,
        metavar=("SCHEMA", "FILE"),
        help="first send a schema file and the bitstreams and overlays that belong to it",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print all configurations; the exit status."""
    with connected(args) as board:
        if args.send:
            board.provision(args.send[0], *args.send[1:])
        configs = [board.config(name) for name in board.configs]
    if args.json:
        print_json([{**plain(c), "schema": None} for c in configs])
        return 0
    rows = [(c.name, c.type, m.name, ", ".join(m.modules), _mark(c.mode, m.name)) for c in configs for m in c.modes]
    print_table(rows, ("CONFIG", "TYPE", "MODE", "MODULES", ""))
    return 0


def _mark(current: str, mode: str) -> str:
    return "loaded" if current == mode else ""
