# SPDX-License-Identifier: Apache-2.0
"""``cm view`` on real terminals and in a window: they show the frame."""

from __future__ import annotations

import contextlib
import re
import shlex
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
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


# ---- tmux ---------------------------------------------------------------------------------


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


# ---- an X server ----------------------------------------------------------------------------


class Display:
    """An X server whose screen is a file (X11/XWDFile.h)."""

    def __init__(self, folder: Path, number: int) -> None:
        self._file = folder / "Xvfb_screen0"
        self.env = {**environment(), "DISPLAY": f":{number}", "LC_ALL": "C.UTF-8"}

    def screen(self) -> Any:
        data = self._file.read_bytes()
        head = struct.unpack(">25I", data[:100])
        width, height, line, colours = head[4], head[5], head[12], head[19]
        pixels = np.frombuffer(data, np.uint8, line * height, head[0] + 12 * colours).reshape(height, line // 4, 4)
        return np.ascontiguousarray(pixels[:, :width, 2::-1])

    def picture(self) -> Any:
        """The lit part of the black screen, without lines of text."""
        screen = self.screen()
        lit = screen.max(2) > 0
        rows = np.flatnonzero(lit.mean(1) > 0.35)
        columns = np.flatnonzero(lit[rows].mean(0) > 0.35) if len(rows) else rows
        return screen[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if len(columns) else screen[:1, :1]

    def shows(self, frame: Any) -> bool:
        """Whether that is the frame, in whatever size."""
        shown = self.picture()
        return shown.shape[1] > 350 and abs(shown.shape[1] / shown.shape[0] - 4 / 3) < 0.05 and near(shown, frame)


@pytest.fixture(scope="module")
def display(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Display]:
    folder = tmp_path_factory.mktemp("screen")
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1000x800x24", "-fbdir", str(folder), "-nolisten", "tcp"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert server.stdout is not None
    yield Display(folder, int(server.stdout.readline()))
    server.terminate()
    server.communicate(timeout=60)


# A terminal that has just begun may answer its first question late, and textual-image waits for 0.1 s.
AWAKE = """
import os, sys, termios, tty
before = termios.tcgetattr(0)
tty.setraw(0)
os.write(1, b"\\x1b[c")
while os.read(0, 1) != b"c":
    pass
termios.tcsetattr(0, termios.TCSANOW, before)
os.execv(sys.argv[1], sys.argv[1:])
"""


def in_awake_terminal(command: Sequence[str]) -> list[str]:
    """The same, once the terminal has answered a question (DA1)."""
    return [sys.executable, "-c", AWAKE, *command]


@contextlib.contextmanager
def running(command: Sequence[str], display: Display) -> Iterator[None]:
    until(lambda: display.picture().size <= 3, WAIT)  # what was there before has gone
    process = subprocess.Popen(command, env=display.env, cwd=REPOSITORY, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait(60)


@needs("Xvfb", "xvfb")
@needs("xterm", "xterm")
def test_xterm_says_that_it_has_sixels_and_shows_the_frame(manager: Manager, frame: Any, display: Display) -> None:
    terminal = ["xterm", "-ti", "vt340", "-geometry", "100x30+0+0", "-bg", "black", "-b", "0", "-bw", "0", "-e"]
    with running([*terminal, *in_awake_terminal(view(manager))], display):
        until(lambda: display.shows(frame), WAIT)


@needs("Xvfb", "xvfb")
@needs("kitty", "kitty")
def test_kitty_is_known_and_shows_the_frame(
    manager: Manager, frame: Any, display: Display, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(display.env, "LIBGL_ALWAYS_SOFTWARE", "1")
    options = (
        "initial_window_width=800",
        "initial_window_height=640",
        "remember_window_size=no",
        "placement_strategy=top-left",
    )
    words = [word for option in (*options, "update_check_interval=0") for word in ("-o", option)]
    with running(["kitty", "--config", "NONE", *words, *in_awake_terminal(view(manager))], display):
        until(lambda: display.shows(frame), WAIT)


@needs("Xvfb", "xvfb")
def test_a_window_shows_the_frame_as_large_as_it_is(manager: Manager, frame: Any, display: Display) -> None:
    pytest.importorskip("tkinter", reason="needs Tk: apt install python3-tk")
    with running(view(manager, "--as", "window"), display):
        until(lambda: display.shows(frame) and display.picture().shape == (480, 640, 3), WAIT)


def test_without_a_display_it_says_what_else_there_is(
    manager: Manager, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("tkinter", reason="needs Tk: apt install python3-tk")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert main(["view", "camera", "--as", "window", "--runtime-dir", str(manager.runtime)]) == 1
    assert "without --as it is drawn in the terminal" in capfd.readouterr().err


# ---- files ------------------------------------------------------------------------------------


def test_output_other_than_a_terminal_needs_a_stated_format(
    manager: Manager, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "camera", "--runtime-dir", str(manager.runtime)]) == 1
    assert "--as kitty, sixel or blocks" in capfd.readouterr().err


@needs("sixel2png", "libsixel-bin")
def test_sixels_in_a_file_are_the_frame(manager: Manager, frame: Any, tmp_path: Path) -> None:
    file = tmp_path / "frame.six"
    with file.open("wb") as out:
        subprocess.run(
            view(manager, "--as", "sixel", "--count", "1"), stdout=out, check=True, env=environment(), cwd="/"
        )
    subprocess.run(["sixel2png", "-i", str(file), "-o", str(tmp_path / "frame.png")], check=True)
    with Image.open(tmp_path / "frame.png") as image:
        assert near(np.asarray(image.convert("RGB")), frame)
