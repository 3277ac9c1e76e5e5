# SPDX-License-Identifier: Apache-2.0
"""Frames in a terminal, in half blocks."""

from __future__ import annotations

import os
import select
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from cm.client.rendering import Bytes, coloured, picture

_RESET = "\x1b[0m"
_BEGIN = "\x1b[?1049h\x1b[?25l"  # the alternate screen, no cursor
_END = "\x1b[?25h\x1b[?1049l"
_HOME, _CLEAR, _TO_END = "\x1b[H", "\x1b[2J", "\x1b[K"
_TOGETHER, _SHOW = "\x1b[?2026h", "\x1b[?2026l"  # no half-drawn pictures, if the terminal knows this mode
Size = tuple[int, int]  # columns and rows


def drawn(frame: npt.NDArray[Any], columns: int, rows: int) -> tuple[str, str]:
    """What draws a frame at the cursor, which then stands below it; and a note about it."""
    pixels, note = picture(frame, columns, 2 * rows)
    return "".join(f"{line}\r\n" for line in half_blocks(pixels)), note


def half_blocks(pixels: Bytes) -> list[str]:
    """A line of text for each two rows: ▀ in two colours (SGR 38 and 48); an odd last row has nothing under it."""
    rows = coloured(pixels)
    if len(rows) % 2:
        rows = np.concatenate([rows, np.zeros_like(rows[:1])])
    return [_line(above, below) for above, below in zip(rows[::2].tolist(), rows[1::2].tolist(), strict=True)]


def _line(above: list[list[int]], below: list[list[int]]) -> str:
    parts, before = [], None
    for pair in zip(above, below, strict=True):
        if pair != before:
            parts.append("\x1b[38;2;{};{};{};48;2;{};{};{}m".format(*pair[0], *pair[1]))
            before = pair
        parts.append("▀")
    return "".join([*parts, _RESET])


class Screen:
    """A terminal that shows frames, and tells of keys."""

    def __init__(self, out: TextIO, size: Callable[[], Size], keys: int) -> None:
        self._out = out
        self._size = size
        self._keys = keys
        self._before: Size | None = None

    def once(self, frame: npt.NDArray[Any]) -> None:
        """A picture that stays, with the cursor under it."""
        columns, rows = self._size()
        self._write(drawn(frame, columns, max(1, rows - 1))[0])

    def draw(self, frame: npt.NDArray[Any], says: str) -> None:
        """Draw in place of the last picture, with a line under it."""
        columns, rows = size = self._size()
        text, note = drawn(frame, columns, max(1, rows - 1))
        clear = _CLEAR if size != self._before else ""
        self._before = size
        line = " · ".join(filter(None, [says, note]))[: columns - 1]
        self._write(f"{_TOGETHER}{clear}{_HOME}{text}\x1b[{rows};1H{line}{_TO_END}{_SHOW}")

    def say(self, line: str) -> None:
        """A line at the bottom, without a new picture."""
        columns, rows = self._size()
        self._write(f"\x1b[{rows};1H{line[: columns - 1]}{_TO_END}")

    def ended(self) -> bool:
        """Whether the user has pressed q or Escape."""
        if not select.select([self._keys], [], [], 0)[0]:
            return False
        return any(key in (ord("q"), 0x1B) for key in os.read(self._keys, 64))

    def begin(self) -> None:
        """Take the screen."""
        self._write(_BEGIN)

    def end(self) -> None:
        """Restore the terminal."""
        self._write(_END)

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()


@contextmanager
def on_terminal() -> Iterator[Screen]:
    """The terminal at our standard output. Raises OSError without one."""
    descriptor = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        with keys_as_they_come(descriptor):
            yield Screen(sys.stdout, lambda: _size_of(descriptor), descriptor)
    finally:
        os.close(descriptor)


def _size_of(descriptor: int) -> Size:
    columns, rows = os.get_terminal_size(descriptor)
    return columns or 80, rows or 24


@contextmanager
def keys_as_they_come(descriptor: int) -> Iterator[None]:
    """Keys are delivered at once and not shown; Ctrl-C works as always."""
    before = termios.tcgetattr(descriptor)
    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[3] &= ~(termios.ECHO | termios.ICANON)  # lflag
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
