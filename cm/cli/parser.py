# SPDX-License-Identifier: Apache-2.0
"""The parser of `cm`: all arguments of one command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from typing import Any, NoReturn

from cm._version import __version__
from cm.cli.commands import COMMANDS, DAY, CommandMissing, add_command, find_command, nearest


class Help(argparse.HelpFormatter):
    """argparse's own asks shutil for the terminal's width, and does so for each argument that is added.

    shutil imports bz2 and lzma: 0.6 MiB of every manager, and 1 ms of every command.
    """

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, **{"width": _columns() - 2, **options})

    def _split_lines(self, text: str, width: int) -> list[str]:
        """Without breaks at hyphens: options, and names such as fpga-cm[web], are to be copied."""
        import textwrap

        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n".join(indent + line for line in self._split_lines(text, width - len(indent)))


class RawHelp(argparse.RawDescriptionHelpFormatter, Help):
    """`Help` that leaves the lines of a description as they are."""


def _columns() -> int:
    """Of the terminal, or $COLUMNS if that is set; 80 if there is neither."""
    given = os.environ.get("COLUMNS", "")
    try:
        return int(given) if given.isdecimal() and int(given) else os.get_terminal_size().columns
    except OSError:
        return 80


DESCRIPTION = "Configuration manager for FPGA systems that reconfigure themselves while they run."
EPILOG = """No board? `cm serve --sim` simulates one. `cm COMMAND --help` says more.
Exit status: 0 done, 1 refused or failed, 2 wrong usage."""


class _Below(argparse._SubParsersAction):  # type: ignore[type-arg]
    """The commands below one: the help of each says what it does, if only with its line in the list of them."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._later: dict[str, Callable[[argparse.ArgumentParser], None]] = {}

    def add_parser(self, name: str, **options: Any) -> Any:
        """`fill`, among the options, gives the parser its arguments when the command is used, and may import then."""
        about = options.get("help") or ""
        options.setdefault("description", f"{about[:1].upper()}{about[1:]}." if about else None)
        self._later |= {name: options.pop("fill")} if "fill" in options else {}
        return super().add_parser(name, **options)

    def fill(self, *names: str) -> None:
        """Give these commands their arguments."""
        for name in names:
            if name in self._later:
                self._later.pop(name)(self.choices[name])

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        self.fill(values[0])
        super().__call__(parser, namespace, values, option_string)


class Parser(argparse.ArgumentParser):
    """A parser that takes no abbreviated options: a script must not break when an option is added."""

    _words: list[str]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("allow_abbrev", False)
        kwargs.setdefault("formatter_class", Help)
        super().__init__(*args, **kwargs)
        self.register("action", "parsers", _Below)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Refuse leftover arguments here, in the parser of their command: `cm` itself would show its own usage."""
        self._words = list(sys.argv[1:] if args is None else args)
        known, left = self._known(self._words, namespace)
        if left:
            self.error(f"unrecognized arguments: {' '.join(left)}{self._near(left)}")
        return known, left

    def _known(self, args: list[str], namespace: Any) -> tuple[Any, list[str]]:
        return super().parse_known_args(args, namespace)

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """Refuse an empty word, as of an unset variable, for a file: `Path` takes it for the current folder."""
        if not arg_string:
            from pathlib import Path

            if action.type is Path:
                raise argparse.ArgumentError(action, "'' is no path")
        return super()._get_value(action, arg_string)

    def error(self, message: str) -> NoReturn:
        """Where an argument is missing, an option that there is none of is what went wrong."""
        if message.startswith("the following arguments are required"):
            words = self._words[: self._words.index("--")] if "--" in self._words else self._words
            wrong = [word for word in words if word[:1] == "-" and len(word) > 1 and not self._has(word)]
            if wrong:
                message = f"unrecognized arguments: {' '.join(wrong)}{self._near(wrong)}"
            elif choices := self._below():
                message = f"what is to be done? {self.prog} {'|'.join(choices)}"
        super().error(message)

    def _has(self, word: str) -> bool:
        """Whether this is an option with or without its value, or a number."""
        known, number = self._option_string_actions, self._negative_number_matcher
        return word.partition("=")[0] in known or word[:2] in known or number.match(word) is not None

    def _below(self) -> list[str]:
        """The actions of this command, where it has any."""
        return [name for action in self._actions if isinstance(action, _Below) for name in action.choices]

    def _near(self, words: list[str]) -> str:
        import difflib  # only those who err need it

        options = [word.partition("=")[0] for word in words if word.startswith("-")]
        near = difflib.get_close_matches(options[0], self._option_string_actions, n=1) if options else []
        return f"; did you mean {near[0]}?" if near else ""


def build_parser(chosen: str | None, helps: bool = False) -> argparse.ArgumentParser:
    """The parser of `cm`, with the arguments of the command called `chosen`, and the help of the others if `helps`.

    Otherwise it does not have the others: each of some sixty parsers looks for translations of its headings on disk.

    Raises `CommandMissing` where that command cannot be imported.
    """
    parser, subparsers = _top()
    for command in COMMANDS:
        if command.name == chosen:
            add_command(command, subparsers)
        elif helps:
            subparsers.add_parser(command.name, help=command.help)
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
    for below in subparsers.choices.values():
        for action in below._actions:
            if isinstance(action, _Below):
                action.fill(*action.choices)
    return parser


def chosen_command(arguments: list[str]) -> str | None:
    """The command in `arguments`: the first word that is not an option. `cm` itself has no options with values."""
    return next((word for word in arguments if not word.startswith("-")), None)


def refuse_unknown(parser: argparse.ArgumentParser, name: str) -> None:
    """End with a usage error where there is no command `name`."""
    if find_command(name) is None:
        _refuse(parser, name)


def _refuse(parser: argparse.ArgumentParser, name: str) -> NoReturn:
    near = nearest(name)
    parser.error(f"there is no command {name}" + (f"; did you mean {near}?" if near else ""))


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
    lines = ["commands of every day:"]
    lines += [f"  {c.name.ljust(width)}  {c.help}" for name in DAY for c in COMMANDS if c.name == name]
    lines += ["", "others, by what they are for:"]
    before = ""
    for command in COMMANDS:
        if command.name not in DAY:
            heading = command.group if command.group != before else ""
            lines.append(f"  {heading.ljust(8)}  {command.name.ljust(width)}  {command.help}")
            before = command.group
    return "\n".join([*lines, "", EPILOG])
