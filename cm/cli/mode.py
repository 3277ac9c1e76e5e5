# SPDX-License-Identifier: Apache-2.0
"""``cm mode MODE``: go to a mode of the loaded configuration."""

from __future__ import annotations

import argparse

from cm.cli.client import connected
from cm.cli.common import completes
from cm.cli.load import add_options, go


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("mode", help="change the mode")
    mode = parser.add_argument("mode", metavar="MODE", help="a mode, or the module that exactly one mode consists of")
    completes(mode, "<mode>")
    add_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Go there; the exit status."""
    with connected(args) as board:
        return go(board, args, "", args.mode)
