# SPDX-License-Identifier: Apache-2.0
"""Every command: its help, wrong words and options, output for scripts; and spellings that were other ones before."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.cli.colours import painted
from cm.cli.commands import COMMANDS, DAY, understood
from cm.cli.main import main
from cm.cli.parser import build_full_parser

CODE = re.compile(r" \[[a-z_]+\]$")
# What runs until it is ended, asks a person, or prints text that is its only purpose.
WITHOUT_JSON = {
    "serve", "sim", "view", "web", "demo", "completion", "build configure", "fleet router",
    "fleet keys", "bridge", "record start",
}  # fmt: skip


Found = Iterator[tuple[str, argparse.ArgumentParser]]


def commands(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()) -> Found:
    """Every command and subcommand that can be run, with the words in front of it, and its parser."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not inner or (words and inner[0].required is False):
        yield " ".join(words), parser
    before = [str(a.metavar or a.dest) for a in parser._actions if not a.option_strings and a.nargs is None]
    for action in inner:
        first_names = {id(below): name for name, below in reversed(action.choices.items())}
        for name in reversed(first_names.values()):
            yield from commands(action.choices[name], (*words, *before, name))


ALL = dict(commands(build_full_parser()))


def refused(line: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The last line that a wrong usage prints."""
    with pytest.raises(SystemExit) as end:
        main(line.split())
    assert end.value.code == 2
    told = capsys.readouterr()
    assert told.out == ""
    return told.err.splitlines()[-1]


def test_the_ten_of_every_day_come_first_and_the_others_by_what_they_are_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    told = capsys.readouterr().out
    assert all(f" {command.name} " in told and command.help in told for command in COMMANDS)
    first, others = told.split("others, by what they are for:")
    assert [line.split()[0] for line in first.partition("every day:")[2].splitlines() if line] == list(DAY)
    headings = ("board", "data", "sharing", "designs", "networks", "run", "try", "shell")
    assert tuple(re.findall(r"^  (\w+)", others, re.MULTILINE)) == headings
    assert {command.group for command in COMMANDS} == set(headings)
    assert max(map(len, others.splitlines())) < 120


@pytest.mark.parametrize("command", ALL)
def test_every_command_has_a_help_that_says_how_to_use_it(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as end:
        main([*command.split(), "--help"])
    assert end.value.code == 0
    told = capsys.readouterr()
    assert told.out.startswith(f"usage: cm {command}")
    assert re.match(r"[A-Z].*\.$", ALL[command].description or "", re.DOTALL), "what it does is said in a sentence"
    assert "==SUPPRESS==" not in told.out
    assert not re.search(r"\w-\n", told.out)  # what is copied from a help is whole
    assert max(map(len, told.out.partition("\n\n")[2].splitlines())) <= 80
    assert told.err == ""


@pytest.mark.parametrize("command", ALL)
def test_a_wrong_option_is_what_the_error_is_about(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where an argument is missing, and with the option that was meant."""
    said = refused(f"{command} --hepl", capsys)
    assert said.endswith("unrecognized arguments: --hepl; did you mean --help?"), said


@pytest.mark.parametrize("command", ALL)
def test_options_that_a_help_names_exist(command: str) -> None:
    parser = ALL[command]
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*[a-z0-9]", parser.format_help()))
    known = {spelling for other in ALL.values() for spelling in other._option_string_actions} | {"--version"}
    assert named <= known


@pytest.mark.parametrize("command", ALL)
def test_a_script_gets_json_of_every_command_that_it_may_read(command: str) -> None:
    known = "--json" in ALL[command]._option_string_actions
    exempt = any(command == name or command.startswith(f"{name} ") for name in WITHOUT_JSON)
    assert known or exempt, command


@pytest.mark.parametrize(
    "line",
    [
        "status", "watch", "load a", "mode a", "mode a/b", "plan a", "unload", "cancel", "reg list", "reg read",
        "reg write a=1",
        "reg watch", "mem list", "mem read a", "irq list", "irq wait a", "stream list",
        "stream capture a b.npy", "stream ping a", "view a", "lease list", "lease give 1", "lease break 1",
        "config list", "config remove a",
    ],
)  # fmt: skip
def test_without_a_manager_every_command_says_so_in_one_line(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ["--runtime-dir", str(tmp_path)]
    assert main([*line.split(), *place]) == 1
    told = capsys.readouterr()
    assert (told.out, told.err.count("\n")) == ("", 1)
    assert told.err.startswith("cm: no configuration manager serves")
    assert CODE.search(told.err.rstrip())
    if "--json" in next(parser for name, parser in ALL.items() if line.startswith(name))._option_string_actions:
        assert main([*line.split(), "--json", *place]) == 1
        assert set(json.loads(capsys.readouterr().out)["error"]) == {"code", "message"}


# ---- spellings ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("short", "full"),
    [
        ("check a.yaml --json", "config check a.yaml --json"),
        ("configs --json", "config list --json"),
        ("fleet ls", "fleet list"),
        ("help configs", "config list --help"),
        ("help", "--help"),
        ("--version configs", "--version config list"),
        ("load ls", "load ls"),
        ("lease take board -- cm configs", "lease take board -- cm configs"),
        ("", ""),
        ("--help", "--help"),
    ],
)
def test_short_spellings_are_understood(short: str, full: str) -> None:
    assert understood(short.split()) == full.split()


@given(st.lists(st.sampled_from(["ls", "list", "--json", "check", "help", "fleet", "--", "x"])))
@settings(max_examples=200)
def test_spellings_are_made_new_once(words: list[str]) -> None:
    assert understood(understood(words)) == understood(words)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("statsu", "there is no command statsu; did you mean status?"),
        ("help rge", "there is no command rge; did you mean reg?"),
        ("cofnigs", "there is no command cofnigs; did you mean config"),
        ("chekc", "did you mean config check?"),  # it was called check
    ],
)
def test_a_command_that_there_is_none_of_is_near_to_one_or_to_what_it_became(
    line: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in refused(line, capsys)


# ---- colours -------------------------------------------------------------------------------


def test_colours_are_for_terminals_unless_something_else_was_said(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal:
        def isatty(self) -> bool:
            return True

    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    terminal: object = Terminal()
    assert painted("idle", "green", terminal) == "\x1b[32midle\x1b[0m"  # type: ignore[arg-type]
    assert painted("idle", "green", None) == "idle"
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted("idle", "green", terminal) == "idle"  # type: ignore[arg-type]
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert painted("idle", "green", terminal) == "idle"  # type: ignore[arg-type]
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert painted("idle", "green", None) != "idle"


def test_an_error_is_red_where_colours_are_wanted_and_plain_in_a_pipe(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = ["status", "--runtime-dir", str(tmp_path)]
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert main(line) == 1
    assert capsys.readouterr().err.startswith("\x1b[31mcm:\x1b[0m no configuration manager")
    monkeypatch.delenv("FORCE_COLOR")
    assert main(line) == 1
    assert "\x1b" not in capsys.readouterr().err
