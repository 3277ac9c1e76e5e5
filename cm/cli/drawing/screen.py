# SPDX-License-Identifier: Apache-2.0
"""Frames drawn one over the other on a terminal, which is restored at the end."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import numpy.typing as npt

from cm.cli.drawing import kitty
from cm.cli.drawing.drawing import Drawing, drawing
from cm.cli.drawing.terminal import Ability, Size, asked, has_true_colour, keys_as_they_come, size_of

_BEGIN = "\x1b[?1049h\x1b[?25l"  # the alternate screen, no cursor
_END = "\x1b[?25h\x1b[?1049l"
_HOME, _CLEAR, _TO_END = "\x1b[H", "\x1b[2J", "\x1b[K"
_TOGETHER, _SHOW = "\x1b[?2026h", "\x1b[?2026l"  # no half-drawn pictures, if the terminal knows this mode


class Screen:
    """Where frames go: a terminal, or a file that gets what a terminal would be sent."""

    def __init__(self, out: TextIO, size: Callable[[], Size], ability: Ability, keys: int | None) -> None:
        self._out = out
        self._size = size
        self._ability = ability
        self._keys = keys
        self._true_colour = has_true_colour(os.environ)
        self._before: Size | None = None

    def once(self, frame: npt.NDArray[Any]) -> None:
        """A picture that stays, with the cursor under it."""
        made = self._drawing(frame)
        below = "\n" * made.rows if self._ability.way == "kitty" else "\n"
        self._write(f"{made.text}{below}")

    def draw(self, frame: npt.NDArray[Any], says: str) -> None:
        """Draw in place of the last picture, with a line under it."""
        made, size = self._drawing(frame), self._size()
        clear = _CLEAR if size != self._before else ""
        self._before = size
        line = " · ".join(filter(None, [says, made.note]))[: size.columns - 1]
        self._write(f"{_TOGETHER}{clear}{_HOME}{made.text}\x1b[{size.rows};1H{line}{_TO_END}{_SHOW}")

    def say(self, line: str) -> None:
        """A line at the bottom, without a new picture."""
        size = self._size()
        self._write(f"\x1b[{size.rows};1H{line[: size.columns - 1]}{_TO_END}")

    def _drawing(self, frame: npt.NDArray[Any]) -> Drawing:
        return drawing(frame, self._ability.way, self._size(), self._true_colour)

    def ended(self) -> bool:
        """Whether the user has pressed q or Escape."""
        if self._keys is None or not select.select([self._keys], [], [], 0)[0]:
            return False
        return any(key in (ord("q"), 0x1B) for key in os.read(self._keys, 64))

    def begin(self) -> None:
        """Take the screen."""
        self._write(_BEGIN)

    def end(self) -> None:
        """Restore the terminal."""
        self._write((kitty.DELETE if self._ability.way == "kitty" else "") + _END)

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()


@contextmanager
def on_terminal(way: str) -> Iterator[Screen]:
    """The terminal at our standard output, asked what it can do unless `way` says it. Raises OSError without one."""
    descriptor = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        with keys_as_they_come(descriptor):
            ability = asked(descriptor) if way == "auto" else Ability(way, asked(descriptor).cell)
            yield Screen(sys.stdout, lambda: size_of(descriptor, ability.cell), ability, descriptor)
    finally:
        os.close(descriptor)


def into_file(way: str, size: Size) -> Screen:
    """Write what a terminal of that size would be sent to standard output."""
    return Screen(sys.stdout, lambda: size, Ability(way, size.cell), None)
