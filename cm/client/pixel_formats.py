# SPDX-License-Identifier: Apache-2.0
"""Pixels as a stream's `format` has them in memory, from and to RGB: arrays of uint8, (rows, columns, …).

YUV is BT.601 with the narrow range of video (Y 16 to 235), in the integers that are usual for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
AS_IT_IS = ("", "rgb")
_PLACES = {"bgr": (2, 1, 0), "rbg": (2, 0, 1)}  # where red, green and blue lie
KNOWN = (*AS_IT_IS, *_PLACES, "yuv422")


def to_rgb(pixels: npt.NDArray[Any], form: str) -> Bytes:
    """A frame in memory as a new array (rows, columns, 3)."""
    found = np.empty((*pixels.shape[:2], 3), np.uint8)
    if form in _PLACES:
        for channel, place in enumerate(_PLACES[form]):
            found[:, :, channel] = pixels[:, :, place]
        return found
    y = 298 * (pixels[:, :, 0].astype(np.int32) - 16) + 128
    cb, cr = (np.repeat(pixels[:, k::2, 1].astype(np.int32) - 128, 2, axis=1) for k in (0, 1))
    for channel, sums in enumerate((y + 409 * cr, y - 100 * cb - 208 * cr, y + 516 * cb)):
        found[:, :, channel] = np.clip(sums >> 8, 0, 255)
    return found


def from_rgb(rgb: npt.NDArray[Any], form: str) -> Bytes:
    """A picture (rows, columns, 3) as the format has it in memory. Two pixels of YUV 4:2:2 share their mean colour."""
    if form in _PLACES:
        found = np.empty(rgb.shape, np.uint8)
        for channel, place in enumerate(_PLACES[form]):
            found[:, :, place] = rgb[:, :, channel]
        return found
    found = np.empty((*rgb.shape[:2], 2), np.uint8)
    r, g, b = (rgb[:, :, channel].astype(np.int32) for channel in range(3))
    found[:, :, 0] = ((66 * r + 129 * g + 25 * b + 128) >> 8) + 16
    r, g, b = ((part[:, 0::2] + part[:, 1::2] + 1) >> 1 for part in (r, g, b))
    found[:, 0::2, 1] = ((-38 * r - 74 * g + 112 * b + 128) >> 8) + 128
    found[:, 1::2, 1] = ((112 * r - 94 * g - 18 * b + 128) >> 8) + 128
    return found


def is_rgb(data: Any) -> bool:
    """Whether something is an array that can be a picture in RGB."""
    return isinstance(data, np.ndarray) and data.dtype == np.uint8 and data.ndim == 3 and data.shape[2] == 3
