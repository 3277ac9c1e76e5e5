# SPDX-License-Identifier: Apache-2.0
"""A frame as text for a terminal: half blocks in 24-bit colour, which every terminal has, or what textual-image makes.

That library has sixels and kitty's graphics protocol, and asks the terminal which of them it has.
"""

from __future__ import annotations

import io
import termios
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.client.pixels import Bytes, coloured, picture
from cm.errors import InvalidRequest

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
        raise InvalidRequest(f"--as {way} needs textual-image: pip install 'fpga-cm[view]'") from None
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
