# SPDX-License-Identifier: Apache-2.0
"""``cm completion names``: names of the manager and its board that may be typed in a command line.

It runs at each Tab, so it is silent where no manager serves, gives up soon, and imports neither numpy nor the clients.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from cm.cli.commands import find_command
from cm.cli.completion.ask import Asker
from cm.cli.completion.tree import completed
from cm.cli.parser import build_parser
from cm.errors import CmError
from cm.messages.status import ConfigInfo, RegisterInfo

_CONNECTION = ("--runtime-dir", "--connect", "--keys")


def names(words: Sequence[str]) -> list[str]:
    """Names that the last of `words` may become; the words before it are the command line after ``cm``."""
    *before, begun = words or [""]
    if not before or find_command(before[0]) is None:
        return []
    try:
        parser, rest = _innermost(build_parser(before[0]), before)
        action, values, options = _position(parser, rest)
        if action is None:
            return []
        with Asker(*(options.get(name) for name in _CONNECTION)) as asker:
            found = _offered(completed(action), asker, values, begun, options.get("--config", ""))
            return sorted({name for name in found if name.startswith(begun)})
    except (CmError, OSError):
        return []


def _innermost(parser: argparse.ArgumentParser, words: Sequence[str]) -> tuple[argparse.ArgumentParser, list[str]]:
    """The parser of the subcommand, and the words behind it."""
    rest = list(words)
    for at, word in enumerate(words):
        inner = next((a for a in parser._actions if isinstance(a, argparse._SubParsersAction)), None)
        if inner is not None and word in inner.choices:
            parser, rest = inner.choices[word], list(words[at + 1 :])
    return parser, rest


def _position(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> tuple[argparse.Action | None, list[str], dict[str, str]]:
    """The argument that the next word is for, the arguments before it, and options with their values."""
    values: list[str] = []
    options: dict[str, str] = {}
    waiting: argparse.Action | None = None
    spelt = {spelling: action for action in parser._actions for spelling in action.option_strings}
    for word in words:
        if waiting is not None:
            options[waiting.option_strings[-1]] = word
            waiting = None
        elif word in spelt:
            waiting = spelt[word] if spelt[word].nargs != 0 else None
        elif not word.startswith("-"):
            values.append(word)
    return waiting or _argument(parser, len(values)), values, options


def _argument(parser: argparse.ArgumentParser, at: int) -> argparse.Action | None:
    """The argument at a place; the last may take any number of words."""
    arguments = [a for a in parser._actions if not a.option_strings and a.nargs != argparse.PARSER]
    if at < len(arguments):
        return arguments[at]
    return arguments[-1] if arguments and arguments[-1].nargs in ("*", "+") else None


def _offered(kinds: Sequence[str], asker: Asker, values: Sequence[str], begun: str, config: str) -> Iterator[str]:
    for kind in kinds:
        if kind in _FAULTS:
            yield from _FAULTS[kind](asker, values)
        elif kind == "<config>":
            yield from asker.configs()
        elif kind == "<mode of config>":
            yield from (mode.name for mode in asker.config(values[0]).modes)
        else:
            yield from _KINDS[kind](asker.config(config), begun)


def _registers(config: ConfigInfo) -> Iterator[RegisterInfo]:
    return (r for r in config.registers if not r.modes or config.mode in r.modes)


def _register_names(config: ConfigInfo, _: str = "") -> Iterator[str]:
    for register in _registers(config):
        yield register.name
        yield from (f"{register.name}.{field.name}" for field in register.fields)


def _assignments(config: ConfigInfo, begun: str) -> Iterator[str]:
    """``NAME=``, and behind that the names of a field's values."""
    name, equals, _ = begun.partition("=")
    if not equals:
        writable = {r.name for r in _registers(config) if r.access != "ro"}
        return (f"{known}=" for known in _register_names(config) if known.partition(".")[0] in writable)
    fields = {f"{r.name}.{f.name}": f for r in _registers(config) for f in r.fields}
    return (f"{name}={value}" for value, _ in fields[name].values) if name in fields else iter(())


_KINDS: Mapping[str, Callable[[ConfigInfo, str], Iterable[str]]] = {
    "<mode>": lambda config, _: (mode.name for mode in config.modes),
    "<register>": _register_names,
    "<assignment>": _assignments,
    "<memory>": lambda config, _: (m.name for m in config.memories if not m.modes or config.mode in m.modes),
    "<interrupt>": lambda config, _: (interrupt.name for interrupt in config.interrupts),
    "<stream>": lambda config, _: (stream.name for stream in config.streams),
    "<channel>": lambda config, _: (stream.channel for stream in config.streams),
}


def _targets(asker: Asker, values: Sequence[str]) -> Iterable[str]:
    """The targets of a fault, by the first word of the description of its kind."""
    from cm.sim.faults import target_of

    what = target_of(values[0]) if values else ""
    config = asker.config() if what else ConfigInfo()
    if what == "overlay":
        return {overlay for mode in config.modes for overlay in mode.overlays}
    known = {"channel": "<channel>", "interrupt": "<interrupt>", "register": "<register>"}
    return _KINDS[known[what]](config, "") if what in known else ()


def _fault_names(_: Asker, __: Sequence[str]) -> Iterable[str]:
    from cm.sim.faults import KINDS

    return KINDS


_FAULTS: Mapping[str, Callable[[Asker, Sequence[str]], Iterable[str]]] = {
    "<fault>": _fault_names,
    "<target>": _targets,
}
