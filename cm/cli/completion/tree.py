# SPDX-License-Identifier: Apache-2.0
"""An argparse parser as a tree of words, which the scripts for the shells are made from."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

from cm.cli.commands import COMMANDS


@dataclass(frozen=True, slots=True)
class Option:
    """An option: its spellings, and what its value may be (choices empty: a file, or anything)."""

    names: tuple[str, ...]
    help: str
    takes_value: bool
    choices: tuple[str, ...]
    live: bool  # a name of what runs


@dataclass(frozen=True, slots=True)
class Word:
    """A command or subcommand; `path` are the words up to it, as in ``cm reg read``."""

    path: str
    help: str
    options: tuple[Option, ...]
    choices: tuple[str, ...]  # of its arguments
    live: bool  # whether an argument is a name of what runs
    files: bool  # whether an argument may be anything, such as a file
    children: tuple[Word, ...]

    @property
    def name(self) -> str:
        """The last word of the path."""
        return self.path.rsplit(" ", 1)[-1]

    def walk(self) -> Iterator[Word]:
        """This word and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()


def command_tree(parser: argparse.ArgumentParser) -> Word:
    """The tree of `parser`; help of commands of the table is theirs."""
    return _word(parser, "cm", "", {command.name: command.help for command in COMMANDS})


def _word(parser: argparse.ArgumentParser, path: str, text: str, known: dict[str, str]) -> Word:
    options, choices, children, live, files = [], [], [], False, False
    for action in parser._actions:  # argparse has no public way to walk a parser; the tests run on every Python
        if isinstance(action, argparse._SubParsersAction):
            helps = known | {choice.dest: _one_line(choice.help) for choice in action._choices_actions}
            for name, child in action.choices.items():
                children.append(_word(child, f"{path} {name}", helps.get(name, ""), {}))
        elif action.option_strings:
            options.append(_option(action))
        else:
            choices += _choices(action)
            live = live or is_live(action)
            files = files or not (action.choices or completed(action))
    return Word(path, text, tuple(options), tuple(choices), live, files, tuple(children))


def _option(action: argparse.Action) -> Option:
    choices = tuple(_choices(action))
    return Option(tuple(action.option_strings), _one_line(action.help), action.nargs != 0, choices, is_live(action))


def completed(action: argparse.Action) -> tuple[str, ...]:
    """What `cm.cli.common.completes` said of it."""
    words: tuple[str, ...] = getattr(action, "completes", ())
    return words


def is_live(action: argparse.Action) -> bool:
    """Whether its value is a name of what runs."""
    return any(word.startswith("<") for word in completed(action))


def _choices(action: argparse.Action) -> list[str]:
    return [str(word) for word in completed(action) or action.choices or () if not str(word).startswith("<")]


def _one_line(text: str | None) -> str:
    if text is None or text == argparse.SUPPRESS:
        return ""
    return " ".join(text.split())
