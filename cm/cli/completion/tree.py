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


@dataclass(frozen=True, slots=True)
class Word:
    """A command or subcommand; `path` are the words up to it, as in ``cm reg read``."""

    path: str
    help: str
    options: tuple[Option, ...]
    choices: tuple[str, ...]  # of its arguments
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
    options, choices, children = [], [], []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = known | {choice.dest: _one_line(choice.help) for choice in action._choices_actions}
            for name, child in action.choices.items():
                children.append(_word(child, f"{path} {name}", helps.get(name, ""), {}))
        elif action.option_strings:
            options.append(_option(action))
        else:
            choices += [str(choice) for choice in action.choices or ()]
    return Word(path, text, tuple(options), tuple(choices), tuple(children))


def _option(action: argparse.Action) -> Option:
    choices = tuple(str(choice) for choice in action.choices or ())
    return Option(tuple(action.option_strings), _one_line(action.help), action.nargs != 0, choices)


def _one_line(text: str | None) -> str:
    if text is None or text == argparse.SUPPRESS:
        return ""
    return " ".join(text.split())
