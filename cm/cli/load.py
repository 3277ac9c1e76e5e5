# SPDX-License-Identifier: Apache-2.0
"""``cm load CONFIG [MODE]`` and ``cm mode MODE``: go to a mode, with a progress bar."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cm.cli.client import connected
from cm.cli.common import add_connection_options, add_json_option, add_lease_option, completes, print_json

if TYPE_CHECKING:
    from cm.client.board import Board


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("load", help="load a configuration")
    completes(parser.add_argument("config", metavar="CONFIG"), "<config>")
    mode = parser.add_argument(
        "mode", metavar="MODE", nargs="?", default="", help="default: the configuration's default"
    )
    completes(mode, "<mode of config>")
    add_options(parser)
    parser.set_defaults(run=run)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what `load` and `mode` share."""
    add_connection_options(parser)
    add_json_option(parser)
    add_lease_option(parser)
    parser.add_argument("--force", action="store_true", help="load it again even if it is loaded already")
    parser.add_argument("--no-wait", action="store_true", help="do not wait until it is done")
    parser.add_argument("--no-queue", action="store_true", help="fail instead of waiting for a running change")


def run(args: argparse.Namespace) -> int:
    """Go there; the exit status."""
    with connected(args) as board:
        return go(board, args, args.config, args.mode)


def go(board: Board, args: argparse.Namespace, config: str, mode: str) -> int:
    """Ask for the mode and tell how it went."""
    if args.no_wait:
        change = board.load_async(config, mode, queue=not args.no_queue, force=args.force, lease=args.lease)
        _tell(args, {"change": change.number, "done": False}, f"change {change.number} is under way")
        return 0
    seconds = board.load(config, mode, progress=True, queue=not args.no_queue, force=args.force, lease=args.lease)
    status = board.status
    told = {"config_name": status.config_name, "mode": status.mode, "seconds": seconds, "done": True}
    _tell(args, told, f"{status.config_name}/{status.mode} after {seconds * 1000:.1f} ms")
    return 0


def _tell(args: argparse.Namespace, value: dict[str, object], text: str) -> None:
    if args.json:
        print_json(value)
    else:
        print(text)
