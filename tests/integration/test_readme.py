# SPDX-License-Identifier: Apache-2.0
"""The README's section on a first mode of one's own runs when it is pasted into a shell."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import REPOSITORY, environment, short_folder
from terminal import Terminal, on_a_terminal

SECTION = re.compile(r"^## A first mode of your own\n(.*?)^## ", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks() -> list[str]:
    """The section's blocks for the shell."""
    section = SECTION.search((REPOSITORY / "README.md").read_text())
    assert section is not None
    return BLOCK.findall(section[1])


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder as it is after `make setup`."""
    with short_folder() as made:
        (made / ".venv/bin").mkdir(parents=True)
        (made / ".venv/bin/activate").write_text(f"PATH={made}/.venv/bin:$PATH\n")
        program = made / ".venv/bin/cm"
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cm "$@"\n')
        program.chmod(0o755)
        yield made


def pasted(terminal: Terminal, text: str, done: Path) -> None:
    """Paste them, and wait until they end."""
    terminal.type(f"{text}echo end >{done}\n", done)


def test_the_first_mode_runs_as_it_is_pasted(folder: Path) -> None:
    first, second = (block.replace("~/.cm", f"{folder}/run") for block in blocks())
    clean = {name: value for name, value in environment().items() if name != "CM_RUNTIME_DIR"}
    env = {**clean, "PS1": "", "TERM": "dumb", "HOME": str(folder), "PATH": os.environ["PATH"]}
    failed = folder / "failed"
    with on_a_terminal(["bash", "--norc", "--noprofile", "-i"], env, folder) as terminal:
        terminal.type(f"trap 'echo \"$BASH_COMMAND\" >>{failed}' ERR; echo >{folder}/ready\n", folder / "ready")
        pasted(terminal, first, folder / "first")
        assert not failed.exists(), failed.read_text() + terminal.shown
        assert "camera/edge_detection after" in terminal.shown
        pasted(terminal, second, folder / "second")
        assert not failed.exists(), failed.read_text() + terminal.shown
    assert "mine/vision.yaml: good: configuration vision, 2 modes" in terminal.shown
    assert "vision/contours after" in terminal.shown
    assert (folder / "contours.png").read_bytes().startswith(b"\x89PNG")
    assert not (folder / "run" / "req").exists(), "the manager was told to end"
