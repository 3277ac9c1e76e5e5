# SPDX-License-Identifier: Apache-2.0
"""Pictures made of characters: ▀ in two colours is two pixels, one above the other. Works on any terminal.

The colours are SGR's 38 and 48 (ECMA-48, ISO 8613-6): of 24 bits, or of xterm's 256.
"""

from __future__ import annotations

import numpy as np

from cm.cli.drawing.pixels import Bytes, coloured

_LEVELS = (0, 95, 135, 175, 215, 255)  # of each colour in xterm's cube of 6 × 6 × 6
_GREYS = tuple(range(8, 239, 10))  # of its 24 greys, from number 232 on
RESET = "\x1b[0m"


def lines(pixels: Bytes, true_colour: bool) -> list[str]:
    """A line of text for each two rows; an odd last row has nothing under it."""
    picture = coloured(pixels)
    if picture.shape[0] % 2:
        picture = np.concatenate([picture, np.zeros_like(picture[:1])])
    codes = _true(picture) if true_colour else _indexed(picture)
    return [_line(codes[row], codes[row + 1]) for row in range(0, len(codes), 2)]


def _line(above: list[str], below: list[str]) -> str:
    parts, before = [], ("", "")
    for pair in zip(above, below, strict=True):
        if pair != before:
            parts.append(f"\x1b[38;{pair[0]};48;{pair[1]}m")
            before = pair
        parts.append("▀")
    return "".join([*parts, RESET])


def _true(picture: Bytes) -> list[list[str]]:
    return [[f"2;{r};{g};{b}" for r, g, b in row] for row in picture.tolist()]


def _indexed(picture: Bytes) -> list[list[str]]:
    """The nearest of the cube, or of the greys where all three colours are alike."""
    levels, greys = np.array(_LEVELS), np.array(_GREYS)
    places = np.abs(picture[..., np.newaxis].astype(np.int16) - levels).argmin(-1)
    numbers = 16 + places @ np.array([36, 6, 1])
    shades = 232 + np.abs(picture[..., :1].astype(np.int16) - greys).argmin(-1)
    grey = (picture.max(-1).astype(np.int16) - picture.min(-1) < 8) & (picture[..., 0] > 3) & (picture[..., 0] < 247)
    return [[f"5;{number}" for number in row] for row in np.where(grey, shades, numbers).tolist()]
