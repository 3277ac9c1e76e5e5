# SPDX-License-Identifier: Apache-2.0
"""``cm help``: the help of `cm`, or of one of its commands."""

from __future__ import annotations

import argparse

from cm.cli.commands import COMMANDS
from cm.cli.common import completes
from cm.cli.parser import build_parser, refuse_unknown


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    words = parser.add_argument(
        "words", metavar="COMMAND", nargs="*", help="a command, such as `reg write` (default: list all)"
    )
    completes(words, *(command.name for command in COMMANDS))
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print it; the exit status."""
    words: list[str] = args.words
    if words:
        refuse_unknown(build_parser(None), words[0])
    parser = build_parser(words[0] if words else None)
    try:
        parser.parse_args([*words, "--help"])
    except SystemExit as end:  # argparse has printed the help, or why there is none
        return end.code if isinstance(end.code, int) else 1
    return 0
