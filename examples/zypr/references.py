# SPDX-License-Identifier: Apache-2.0
"""What the authors' filters should give, from the definitions of the operations and not from their Verilog.

The integer steps are those of xfOpenCV, which HLS compiled: constants, tables and roundings of OpenCV's 8-bit versions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
BLUE = ((94, 20, 15), (126, 255, 255))  # hue in steps of two degrees, saturation, value: what chroma lets through


def sobel(grey: Picture) -> Picture:
    """Half of each gradient, 3x3 Sobel, negative ones 0 and saturated; beyond the picture everything is 0."""
    p = np.pad(grey.astype(np.int32), 1)
    gx = p[:-2, 2:] - p[:-2, :-2] + 2 * (p[1:-1, 2:] - p[1:-1, :-2]) + p[2:, 2:] - p[2:, :-2]
    gy = p[2:, :-2] - p[:-2, :-2] + 2 * (p[2:, 1:-1] - p[:-2, 1:-1]) + p[2:, 2:] - p[:-2, 2:]
    return ((np.clip(gx, 0, 255) >> 1) + (np.clip(gy, 0, 255) >> 1)).astype(np.uint8)


def resize(grey: Picture, shape: tuple[int, int]) -> Picture:
    """The mean of the pixels that one of the result covers, for whole factors; halves are rounded up (INTER_AREA)."""
    down, across = grey.shape[0] // shape[0], grey.shape[1] // shape[1]
    total = grey.astype(np.int64).reshape(shape[0], down, shape[1], across).sum(axis=(1, 3))
    return ((2 * total + down * across) // (2 * down * across)).astype(np.uint8)


def hsv(bgr: Picture) -> NDArray[Any]:
    """Hue (0 to 179), saturation and value of OpenCV's BGR2HSV for 8 bits, with its tables of 12 fractional bits."""
    b, g, r = (bgr[..., channel].astype(np.int64) for channel in range(3))
    value, least = np.maximum(np.maximum(b, g), r), np.minimum(np.minimum(b, g), r)
    spread = value - least
    by_value = np.rint((255 << 12) / np.maximum(value, 1)).astype(np.int64)
    by_spread = np.where(spread, np.rint((180 << 12) / (6 * np.maximum(spread, 1))), 0).astype(np.int64)
    saturation = np.where(value, (spread * by_value + (1 << 11)) >> 12, 0)
    turn = np.where(value == r, g - b, np.where(value == g, b - r + 2 * spread, r - g + 4 * spread))
    hue = (turn * by_spread + (1 << 11)) >> 12
    return np.stack([np.where(hue < 0, hue + 180, hue), saturation, value], axis=-1)


def chroma(bgr: Picture) -> Picture:
    """255 where the colour is in BLUE, else 0."""
    found = hsv(bgr)
    return (255 * ((found >= BLUE[0]) & (found <= BLUE[1])).all(axis=-1)).astype(np.uint8)
