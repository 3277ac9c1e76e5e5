# SPDX-License-Identifier: Apache-2.0
"""Frames drawn on a terminal, which is restored at the end: in half blocks, or as textual-image draws them."""

from __future__ import annotations

import io
import os
import re
import select
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from cm.client.rendering import Bytes, coloured, picture
from cm.errors import InvalidRequest
from cm.extras import installing

WAYS = ("kitty", "sixel", "blocks")
_CELL = (10, 20)  # pixels of a character that a picture is made for; the terminal's own may differ
_SIDE = 1280  # most pixels of such a picture, in either direction
_RESET = "\x1b[0m"


class Drawer:
    """Draws in one of `WAYS`, or with ``auto`` the best that this terminal has. Raises InvalidRequest."""

    def __init__(self, way: str) -> None:
        self._kind = None if way == "blocks" else _kind(way)
        self._last: Any = None  # what the terminal keeps of it is deleted with the next

    @property
    def uses_placeholders(self) -> bool:
        """Whether pictures are characters that a terminal replaces, by an addition to kitty's protocol of 2023."""
        return self._kind is not None and self._kind.__module__.endswith(".tgp")

    def text(self, frame: npt.NDArray[Any], columns: int, rows: int) -> tuple[str, str]:
        """What draws a frame at the cursor, which then stands below it; and a note about it."""
        if self._kind is None:
            pixels, note = picture(frame, columns, 2 * rows)
            return "".join(f"{line}\r\n" for line in half_blocks(pixels)), note
        pixels, note = picture(frame, min(columns * _CELL[0], _SIDE), min(rows * _CELL[1], _SIDE))
        return self._printed(self._kind, pixels, columns, rows), note

    def _printed(self, kind: Any, pixels: Bytes, columns: int, rows: int) -> str:
        from PIL import Image
        from rich.console import Console

        before, self._last = self._last, kind(Image.fromarray(_at_least_a_cell(pixels, columns, rows)), "auto", "auto")
        out = io.StringIO()
        console = Console(file=out, width=columns, height=rows, force_terminal=True, color_system="truecolor")
        console.print(self._last, end="")
        if before is not None:
            before.cleanup()
        return out.getvalue()

    def close(self) -> None:
        """Have the terminal forget the last picture."""
        if self._last is not None:
            self._last.cleanup()
            self._last = None


def _kind(way: str) -> Any:
    """The library's class of pictures; None for half blocks, which are ours."""
    try:
        from textual_image import renderable  # asks the terminal, on standard input
    except ModuleNotFoundError:
        if way == "auto":
            return None
        raise InvalidRequest(f"--as {way} needs textual-image: {installing('view')}") from None
    except (termios.error, OSError) as error:
        if way == "auto":
            return None
        raise InvalidRequest(
            f"--as {way}: the terminal cannot be asked ({error}); --as blocks needs no answer"
        ) from None
    kinds = {"kitty": renderable.TGPImage, "sixel": renderable.SixelImage}
    found = kinds.get(way, renderable.Image)
    return found if found in kinds.values() else None


def _at_least_a_cell(pixels: Bytes, columns: int, rows: int) -> Bytes:
    """With black below or beside what would be less than half a character, for which the library takes none."""
    height, width = pixels.shape[:2]
    below, beside = max(0, -(-2 * width // columns) - height), max(0, -(-height // (2 * rows)) - width)
    edges = ((0, below), (0, beside), (0, 0))[: pixels.ndim]
    return np.ascontiguousarray(np.pad(pixels, edges) if below or beside else pixels)


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


_BEGIN = "\x1b[?1049h\x1b[?25l"  # the alternate screen, no cursor
_END = "\x1b[?25h\x1b[?1049l"
_HOME, _CLEAR, _TO_END = "\x1b[H", "\x1b[2J", "\x1b[K"
_TOGETHER, _SHOW = "\x1b[?2026h", "\x1b[?2026l"  # no half-drawn pictures, if the terminal knows this mode
_ANSWER = 1.0  # seconds in which a terminal answers, even over a slow line
Size = tuple[int, int]  # columns and rows


class Screen:
    """Where frames go: a terminal, or a file that gets what a terminal would be sent."""

    def __init__(self, out: TextIO, size: Callable[[], Size], drawer: Drawer, keys: int | None = None) -> None:
        self._out = out
        self._size = size
        self._drawer = drawer
        self._keys = keys
        self._before: Size | None = None

    def once(self, frame: npt.NDArray[Any]) -> None:
        """A picture that stays, with the cursor under it."""
        columns, rows = self._size()
        self._write(self._drawer.text(frame, columns, max(1, rows - 1))[0])

    def draw(self, frame: npt.NDArray[Any], says: str) -> None:
        """Draw in place of the last picture, with a line under it."""
        columns, rows = size = self._size()
        text, note = self._drawer.text(frame, columns, max(1, rows - 1))
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
        if self._keys is None or not select.select([self._keys], [], [], 0)[0]:
            return False
        return any(key in (ord("q"), 0x1B) for key in os.read(self._keys, 64))

    def begin(self) -> None:
        """Take the screen."""
        self._write(_BEGIN)

    def end(self) -> None:
        """Restore the terminal."""
        self._drawer.close()
        self._write(_END)

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()


@contextmanager
def on_terminal(way: str) -> Iterator[Screen]:
    """The terminal at our standard output. Raises OSError without one, and InvalidRequest."""
    descriptor = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        with keys_as_they_come(descriptor):
            drawer = Drawer(way)
            if drawer.uses_placeholders and _old_kitty(descriptor):
                if way == "kitty":
                    raise InvalidRequest("--as kitty needs kitty 0.28 or newer")
                drawer = Drawer("blocks")
            yield Screen(sys.stdout, lambda: _size_of(descriptor), drawer, descriptor)
    finally:
        os.close(descriptor)


def into_file(way: str, size: Size) -> Screen:
    """Write what a terminal of that size would be sent to standard output. Raises InvalidRequest."""
    return Screen(sys.stdout, lambda: size, Drawer(way))


def _old_kitty(descriptor: int) -> bool:
    """Whether the terminal is a kitty that has its protocol, but not the placeholders that the library draws with.

    XTVERSION asks for its name; DA1, which every terminal answers, says that no more will come.
    """
    os.write(descriptor, b"\x1b[>q\x1b[c")
    answer, end = b"", time.monotonic() + _ANSWER
    while not re.search(rb"\x1b\[\?[\d;]*c", answer) and (left := end - time.monotonic()) > 0:
        if select.select([descriptor], [], [], left)[0]:
            answer += os.read(descriptor, 4096)
    found = re.search(rb"kitty\((\d+)\.(\d+)", answer)
    return found is not None and (int(found[1]), int(found[2])) < (0, 28)


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
