# SPDX-License-Identifier: Apache-2.0
"""``cm view`` in a terminal: it shows the frame."""

from __future__ import annotations

import contextlib
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager, environment, served, until
from PIL import Image

from cm.cli.main import main

pytestmark = pytest.mark.programs
WAIT = 60.0
HERE = shlex.join(["cd", str(REPOSITORY)])
SGR = re.compile(r"\x1b\[([\d;]*)m|(.)", re.DOTALL)


def needs(program: str, package: str) -> Any:
    return pytest.mark.skipif(not shutil.which(program), reason=f"needs {program}: apt install {package}")


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    """A camera that looks at one photograph for ever."""
    with served(board=["--hold", "0"]) as (manager, _):
        with manager.connected() as board:
            board.load("camera", "default")
        yield manager


@pytest.fixture(scope="module")
def frame(manager: Manager) -> Any:
    """That photograph."""
    with manager.connected() as board, board.stream("camera", timeout=WAIT) as stream:
        return stream.read().copy()


def view(manager: Manager, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "cm", "view", "camera", "--runtime-dir", str(manager.runtime), *arguments]


def near(shown: Any, frame: Any) -> bool:
    """Whether a picture roughly equals the frame in another size."""
    small = [np.asarray(Image.fromarray(p).convert("L").resize((16, 12), Image.Resampling.BOX)) for p in (shown, frame)]
    return bool(np.abs(small[0].astype(int) - small[1]).mean() < 8)


class Tmux:
    """A separate tmux server."""

    def __init__(self, folder: Path) -> None:
        self._command = ["tmux", "-S", str(folder / "tmux"), "-f", "/dev/null"]

    def do(self, *words: str) -> str:
        return subprocess.run(
            [*self._command, *words], capture_output=True, text=True, check=True, env=self.env()
        ).stdout

    @staticmethod
    def env() -> dict[str, str]:
        return {**environment(), "COLORTERM": "truecolor", "LC_ALL": "C.UTF-8", "TERM": "xterm-256color"}


@pytest.fixture
def tmux(tmp_path: Path) -> Iterator[Tmux]:
    made = Tmux(tmp_path)
    yield made
    with contextlib.suppress(subprocess.CalledProcessError):
        made.do("kill-server")


def cells(text: str) -> Any:
    """The pixels of half blocks as a terminal kept them: rows of text with SGR."""
    rows: list[list[tuple[int, ...]]] = []
    colours = {"38": (0, 0, 0), "48": (0, 0, 0)}
    for line in text.splitlines():
        above, below = [], []
        for codes, letter in SGR.findall(line):
            for plane, red, green, blue in re.findall(r"(38|48)[;:]2[;:](\d+)[;:](\d+)[;:](\d+)", codes):
                colours[plane] = (int(red), int(green), int(blue))
            if letter == "▀":
                above.append(colours["38"])
                below.append(colours["48"])
        rows += [above, below] if above else []
    width = min(map(len, rows), default=0)
    return np.array([row[:width] for row in rows], np.uint8)


@needs("tmux", "tmux")
def test_tmux_shows_the_frame_in_half_blocks_and_is_given_back_as_it_was(
    manager: Manager, frame: Any, tmux: Tmux
) -> None:
    shell = f"{HERE}; echo before; {shlex.join(view(manager))}; echo after $?; exec sleep 600"
    tmux.do("new-session", "-d", "-x", "100", "-y", "31", shell)
    until(lambda: "(q ends)" in tmux.do("capture-pane", "-p"), WAIT)
    shown = cells(tmux.do("capture-pane", "-p", "-e"))
    assert shown.shape == (60, 80, 3)
    assert near(shown, frame)
    assert "camera/default  480 × 640 uint8" in tmux.do("capture-pane", "-p").splitlines()[-1]
    tmux.do("send-keys", "q")
    until(lambda: "after 0" in tmux.do("capture-pane", "-p"), WAIT)
    left = tmux.do("capture-pane", "-p")
    assert "before" in left
    assert "▀" not in left


@needs("tmux", "tmux")
def test_a_picture_by_itself_stays_on_the_screen(manager: Manager, frame: Any, tmux: Tmux) -> None:
    shell = f"{HERE}; {shlex.join(view(manager, '--count', '1'))}; echo after; exec sleep 600"
    tmux.do("new-session", "-d", "-x", "60", "-y", "40", shell)
    until(lambda: "after" in tmux.do("capture-pane", "-p"), WAIT)
    assert near(cells(tmux.do("capture-pane", "-p", "-e")), frame)


def test_without_a_terminal_the_command_that_writes_files_is_named(
    manager: Manager, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "camera", "--runtime-dir", str(manager.runtime)]) == 1
    assert "cm stream capture" in capfd.readouterr().err
