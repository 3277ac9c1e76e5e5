# SPDX-License-Identifier: Apache-2.0
"""Tab in bash, zsh and fish knows the names of what runs: each shell itself completes, on a terminal."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import Manager, environment
from terminal import on_a_terminal

import cm
from cm.cli.completion import script

# What is typed, and what Tab completes it to (with a blank if the word is complete).
LINES = {
    "cm mode edg": "cm mode edge_detection ",
    "cm load camera loopback_": "cm load camera loopback_edge ",
    "cm mode camera/colo": "cm mode camera/colorise ",
    "cm reg read led.bl": "cm reg read led.blink ",
    "cm reg write foc": "cm reg write focus=",
    "cm reg write led.blink=fa": "cm reg write led.blink=fast ",
    "cm irq wait frame": "cm irq wait frame_done ",
    "cm sim inject register_stuck scr": "cm sim inject register_stuck scratch ",
}


@pytest.fixture
def folder(tmp_path: Path, manager: Manager, board: cm.Board) -> Path:
    """A folder with a `cm` to run, and the scripts of all shells."""
    assert board.mode == "default"
    program = tmp_path / "cm"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cm "$@"\n')
    program.chmod(0o755)
    for shell in ("bash", "zsh", "fish"):
        (tmp_path / f"cm.{shell}").write_text(script(shell))
    return tmp_path


def at(folder: Path, manager: Manager) -> dict[str, str]:
    """The environment of a user's shell with that manager."""
    return {
        **environment(),
        "PATH": f"{folder}:{os.environ['PATH']}",
        "CM_RUNTIME_DIR": str(manager.runtime),
        "HOME": str(folder),
        "TERM": "dumb",
        "PS1": "",
    }


BEGIN = {
    "bash": (["bash", "--norc", "--noprofile", "-i"], "source {folder}/cm.bash"),
    "zsh": (["zsh", "-f", "-i"], "autoload -U compinit; compinit -u; bindkey -e; source {folder}/cm.zsh"),
}


@pytest.mark.parametrize("shell", ["bash", pytest.param("zsh", marks=pytest.mark.programs)])
def test_tab_on_a_terminal_completes_names_of_what_runs(shell: str, folder: Path, manager: Manager) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"needs_{shell}")
    arguments, begin = BEGIN[shell]
    with on_a_terminal(arguments, at(folder, manager), folder) as terminal:
        terminal.type(f"{begin.format(folder=folder)}; echo ready > {folder}/ready\n", folder / "ready")
        for number, (line, expected) in enumerate(LINES.items()):
            for attempt in range(5):  # where the manager does not answer within a second, nothing is offered
                kept = folder / f"{number}.{attempt}"
                # To the beginning of the line, so that the completion is printed and not run: Ctrl-A, Ctrl-E.
                found = terminal.type(f"{line}\t'\x01printf '%s\\n' '\x05 > {kept}\n", kept)
                if found != f"{line}\n":
                    break
            assert found == f"{expected}\n"


def at_tab(line: str, env: dict[str, str]) -> list[str]:
    """What is offered, by the protocol of argcomplete's scripts."""
    told = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    command = ["sh", "-c", f'"{sys.executable}" -m cm 8>&1 >&2']
    ran = subprocess.run(command, env={**env, **told}, capture_output=True, text=True, timeout=60, check=False)
    assert ran.stderr == ""
    return ran.stdout.split("\n") if ran.stdout else []


@pytest.mark.programs
def test_fish_completes_names_of_what_runs(folder: Path, manager: Manager) -> None:
    if shutil.which("fish") is None:
        pytest.skip("needs_fish")
    asked = "".join(f"echo; complete -C '{line}'\n" for line in LINES)
    told = subprocess.run(
        ["fish", "--no-config"],
        input=f"source {folder}/cm.fish\n{asked}",
        env=at(folder, manager),
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout
    for answer, expected in zip(told.split("\n\n"), LINES.values(), strict=False):
        assert answer.strip().split("\t")[0] == expected.split(" ")[-2 if expected.endswith(" ") else -1], told


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("cm comp", ["completion "]),
        ("cm completion ", ["bash", "zsh", "fish"]),
        ("cm sim inj", ["inject "]),
        ("cm config check --js", ["--json "]),
        ("cm nothing x", []),
    ],
)
def test_commands_options_and_their_values_are_offered(line: str, expected: list[str]) -> None:
    assert sorted(at_tab(line, environment())) == sorted(expected)


@pytest.mark.parametrize("option", ["--runtime-dir", "--connect"])
def test_another_manager_than_the_default_is_asked_where_the_line_names_it(
    option: str, board: cm.Board, manager: Manager
) -> None:
    assert board.mode == "default"
    assert at_tab(f"cm mode {option} {manager.runtime} edg", environment()) == ["edge_detection "]


@pytest.mark.parametrize("line", ["cm mode e", "cm reg read f"])
def test_without_a_manager_nothing_is_offered_or_printed(line: str, tmp_path: Path) -> None:
    assert at_tab(line, {**environment(), "CM_RUNTIME_DIR": str(tmp_path)}) == []


def test_names_at_tab_cost_neither_numpy_nor_a_client() -> None:
    code = (
        "import argparse, sys\nfrom cm.cli.completion import offered\noffered(['<mode>'], '', argparse.Namespace())\n"
    )
    code += "print([n for n in sys.modules if n in ('numpy', 'cm.client.board', 'yaml')])"
    told = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True)
    assert told.stdout == "[]\n"
