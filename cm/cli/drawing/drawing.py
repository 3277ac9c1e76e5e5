# SPDX-License-Identifier: Apache-2.0
"""A frame as text for a terminal, in one of the three ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.cli.drawing import half_blocks, kitty, sixel
from cm.cli.drawing.pixels import Bytes, fitted, outline, plotted, visible
from cm.cli.drawing.terminal import Size

WAYS = ("kitty", "sixel", "blocks")
_SIDE = 1280  # most pixels of a picture, in either direction


@dataclass(frozen=True, slots=True)
class Drawing:
    """Text that draws a picture at the cursor, the rows that it takes, and a description of the picture."""

    text: str
    rows: int
    note: str = ""


def drawing(frame: npt.NDArray[Any], way: str, size: Size, true_colour: bool) -> Drawing:
    """A frame in at most the terminal's columns, and its rows but for one."""
    columns, rows = size.columns, max(1, size.rows - 1)
    width, height = size.cell
    room = (columns, 2 * rows) if way == "blocks" else (min(columns * width, _SIDE), min(rows * height, _SIDE))
    picture, note = _picture(np.asarray(frame), room)
    if way == "blocks":
        lines = half_blocks.lines(picture, true_colour)
        return Drawing("\r\n".join(lines), len(lines), note)
    tall = -(-picture.shape[0] // height)
    if way == "sixel":
        return Drawing(sixel.encoded(picture), tall, note)
    return Drawing(kitty.encoded(picture, -(-picture.shape[1] // width), tall), tall, note)


def _picture(frame: npt.NDArray[Any], room: tuple[int, int]) -> tuple[Bytes, str]:
    if frame.size == 0:
        return np.zeros((1, 1), np.uint8), "nothing in it"
    if frame.ndim < 2:
        signal = outline(np.atleast_1d(frame), room[0])
        low, high = signal.span
        return plotted(signal, room[0], min(room[1], room[0] // 2 + 1)), f"{low:g} to {high:g}"
    seen = visible(frame, 4 * _SIDE)
    note = f"{seen.span[0]:g} to {seen.span[1]:g}" if seen.span else ""
    return fitted(seen.pixels, *room), note
