# SPDX-License-Identifier: Apache-2.0
"""Independent references, which share nothing with the simulator."""

from __future__ import annotations

import numpy as np


def sobel(photo: np.ndarray) -> np.ndarray:
    """An independent reference: loops over the kernel's taps in int64, nothing shared with the simulator."""
    source = photo.astype(np.int64)
    kernel = ((-1, 0, 1), (-2, 0, 2), (-1, 0, 1))
    height, width = source.shape
    gx = np.zeros((height - 2, width - 2), np.int64)
    gy = np.zeros_like(gx)
    for row in range(3):
        for column in range(3):
            window = source[row : row + height - 2, column : column + width - 2]
            gx += kernel[row][column] * window
            gy += kernel[column][row] * window
    result = np.zeros(source.shape, np.uint8)
    result[1:-1, 1:-1] = np.minimum(np.abs(gx) + np.abs(gy), 255)
    return result
