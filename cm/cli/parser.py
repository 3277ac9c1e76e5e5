# SPDX-License-Identifier: Apache-2.0
"""The parser of `cm`: all arguments of one command, and only name and help of the others."""

from __future__ import annotations

import argparse
import difflib
from typing import Any, NoReturn

from cm._version import __version__
from cm.cli.commands import COMMANDS, CommandMissing, add_command, find_command
from cm.cli.help_format import Help, RawHelp

DESCRIPTION = "Configuration manager for FPGA systems that reconfigure themselves while they run."
EPILOG = "`cm COMMAND --help` says more. Exit status: 0 done, 1 refused or failed, 2 wrong usage."


class Parser(argparse.ArgumentParser):
    """A parser that takes no abbreviated options: a script must not break when an option is added."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("allow_abbrev", False)
        kwargs.setdefault("formatter_class", Help)
        super().__init__(*args, **kwargs)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Refuse leftover arguments here, in the parser of their command: `cm` itself would show its own usage."""
        known, left = super().parse_known_args(args, namespace)
        if left:
            self.error(f"unrecognized arguments: {' '.join(left)}")
        return known, left


def build_parser(chosen: str | None, helps: bool = False) -> argparse.ArgumentParser:
    """The parser of `cm`, with the arguments of the command called `chosen`, and the help of the others if `helps`.

    Raises `CommandMissing` where that command cannot be imported.
    """
    parser, subparsers = _top()
    for command in COMMANDS:
        if command.name == chosen:
            add_command(command, subparsers)
        elif helps:
            subparsers.add_parser(command.name, help=command.help)
        else:
            subparsers.add_parser(command.name)  # without help, so that _epilog() alone lists it
    return parser


def build_full_parser() -> argparse.ArgumentParser:
    """The parser with the arguments of every command that is installed."""
    parser, subparsers = _top()
    for command in COMMANDS:
        try:
            add_command(command, subparsers)
        except CommandMissing:
            if command.name not in subparsers.choices:
                subparsers.add_parser(command.name, help=command.help)
    return parser


def chosen_command(arguments: list[str]) -> str | None:
    """The command in `arguments`: the first word that is not an option. `cm` itself has no options with values."""
    return next((word for word in arguments if not word.startswith("-")), None)


def refuse_unknown(parser: argparse.ArgumentParser, name: str) -> None:
    """End with a usage error where there is no command `name`."""
    if find_command(name) is None:
        _refuse(parser, name)


def _refuse(parser: argparse.ArgumentParser, name: str) -> NoReturn:
    near = difflib.get_close_matches(name, [command.name for command in COMMANDS], n=1)
    parser.error(f"there is no command {name}" + (f"; did you mean {near[0]}?" if near else ""))


def _top() -> tuple[argparse.ArgumentParser, argparse._SubParsersAction[argparse.ArgumentParser]]:
    parser: argparse.ArgumentParser = Parser(
        prog="cm",
        usage="cm [-h] [--version] COMMAND ...",
        description=DESCRIPTION,
        epilog=_epilog(),
        formatter_class=RawHelp,
    )
    parser.add_argument("--version", action="version", version=f"cm {__version__}")
    return parser, parser.add_subparsers(prog="cm", dest="command", metavar="COMMAND", help=argparse.SUPPRESS)


def _epilog() -> str:
    """The commands in columns; argparse breaks the line after a name that is longer than "COMMAND"."""
    width = max(len(command.name) for command in COMMANDS)
    lines = [f"  {command.name.ljust(width)}  {command.help}" for command in COMMANDS]
    return "\n".join(["commands:", *lines, "", EPILOG])
